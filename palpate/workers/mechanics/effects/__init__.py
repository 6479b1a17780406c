"""The effects that a model may lack: one file for each family."""
