"""The thesis reproduced: its experiments run, compared with what it prints, bound as a book."""
