"""Subcommands of `motorlens`, one file each."""
