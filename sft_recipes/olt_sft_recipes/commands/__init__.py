"""The subcommands of `olt` that this package brings; each module imports its work only when called."""
