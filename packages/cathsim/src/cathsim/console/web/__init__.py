"""The console's web server, and what the pages and it say to each other."""
