"""Bodies: phantoms, images and their meshes."""
