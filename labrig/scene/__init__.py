"""What a simulated camera sees."""
