"""Web pages of stored results, each in one file that needs no network."""
