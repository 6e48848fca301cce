"""A model of one's own: any object with infer(x), and with preprocess(x) and postprocess(y) where it needs them."""


class Nearest:
    """Finds the direction of the nearest wall."""

    def preprocess(self, distances):
        return [(distance, degree) for degree, distance in enumerate(distances)]

    def infer(self, pairs):
        return min(pairs)

    def postprocess(self, nearest):
        distance, degree = nearest
        return {"degree": degree, "metres": distance}
