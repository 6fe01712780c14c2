"""The command line, a file for each command, and what joins the rooms: demo, reports, benches."""
