"""Repositories: all queries of the service. One module a noun; each takes and returns records."""
