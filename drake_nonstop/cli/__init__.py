"""The command `drake-nonstop`, one module per subcommand: parse, call, print; no computation."""
