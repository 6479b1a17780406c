"""Search strategies: pure functions that map past generations to the next candidates."""
