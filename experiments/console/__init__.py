"""What every command says to its user: tables, progress, one line for an error."""
