"""Policies for other machines: as C99, ONNX or Structured Text, with contract, test vectors and an example."""
