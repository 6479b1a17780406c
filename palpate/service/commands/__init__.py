"""Commands, one per file; heavy imports are deferred to the call, so that help is fast."""
