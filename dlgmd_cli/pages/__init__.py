"""Web pages of stored results, which need no network."""
