"""A user-defined model: any object with infer(x) and, optionally, preprocess(x) and postprocess(y)."""


class Nearest:
    """Finds the direction of the nearest wall."""

    def preprocess(self, distances):
        return [(distance, degree) for degree, distance in enumerate(distances)]

    def infer(self, pairs):
        return min(pairs)

    def postprocess(self, nearest):
        distance, degree = nearest
        return {"degree": degree, "metres": distance}
