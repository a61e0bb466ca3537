"""Design of experiments and of controllers: what motions and sensors can determine, and what may be relied on."""
