"""Policies for other machines: as C99 or ONNX, with their observation contract, test vectors and an example."""
