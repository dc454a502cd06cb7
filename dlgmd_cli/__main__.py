"""`python -m dlgmd_cli`."""

from dlgmd_cli.app import main

main()
