# What this package uses of coal, a compiled module without annotations.
class BVHModelBase:
    convex: object
    def buildConvexHull(self, keepTriangles: bool, qhullCommand: str) -> None: ...

class Box:
    def __init__(self, x: float, y: float, z: float) -> None: ...
