"""From a scene to a run folder."""
