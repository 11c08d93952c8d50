"""Design for a target: what is asked, the search, its verification, and what was found."""
