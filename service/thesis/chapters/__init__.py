"""The chapters of the book, one file each: results in, words, tables and pictures out."""
