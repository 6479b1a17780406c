"""Makes, seals, diagnoses and scores cases whose cause the diagnosis cannot know."""
