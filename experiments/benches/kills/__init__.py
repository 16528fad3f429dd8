"""Commands and generations that are killed at random moments, and the server that they write to."""
