"""What is special to one organ."""
