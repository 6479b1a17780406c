"""One command, one file. They import what they need when they are called: help stays quick."""
