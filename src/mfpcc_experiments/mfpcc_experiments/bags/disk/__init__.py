"""A bag on disk: MCAP as records and chunks, and files of every kind that a bag is stored in."""
