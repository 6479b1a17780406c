"""Why a simulated body differs from the imaged one: asked of the workers, told to the user."""
