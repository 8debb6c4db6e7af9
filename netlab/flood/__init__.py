"""``mesh: flood``: a layer-2 mesh that floods every frame and learns nothing, the baseline for those that route."""
