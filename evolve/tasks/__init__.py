"""The tasks that have names, each in a file as a user would write it."""
