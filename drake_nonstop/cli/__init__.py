"""The command `drake-nonstop`: its subcommands parse, call and print; no computation."""
