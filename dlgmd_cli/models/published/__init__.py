"""The models of the field, each checked against the numbers of its public code."""
