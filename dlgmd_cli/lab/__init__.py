"""The laboratory: it renders flights, checks the paper, and measures what the pages say.

It uses the public names of `dlgmd_cli`, and few of its modules; the tool does not use it.
"""
