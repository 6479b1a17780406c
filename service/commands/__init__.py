"""Holds one command a file. Each imports what it needs when it is called: help stays quick."""
