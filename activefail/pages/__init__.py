"""What is written and drawn: report, explorer, figures."""
