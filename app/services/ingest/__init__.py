"""What phones push: tokens that let them, recordings as they come in, and what becomes of these."""
