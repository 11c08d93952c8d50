"""HTML and Markdown pages: prose in templates, numbers from findings."""
