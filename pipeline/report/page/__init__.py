"""The page of the report: headlines, film, chapters with their figures, one static HTML file."""
