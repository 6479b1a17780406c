"""An effect, a law, a score and an organ that Palpate finds by their entry points."""
