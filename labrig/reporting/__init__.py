"""What figures and pages show of results, and how they are drawn."""
