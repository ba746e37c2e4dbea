"""What every command needs: the command line, printing, worker processes, files of settings."""
