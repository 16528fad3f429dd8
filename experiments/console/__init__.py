"""Output shared by every command: tables, progress, one line for an error."""
