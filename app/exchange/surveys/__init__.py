"""Surveys as files: the project's own archives, and recordings of others."""
