"""Make a body: phantoms, images and their meshes."""
