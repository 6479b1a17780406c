"""What a model may lack: one file an effect."""
