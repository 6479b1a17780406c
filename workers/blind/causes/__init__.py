"""Define what may differ from the nominal physics, each in a form of its own."""
