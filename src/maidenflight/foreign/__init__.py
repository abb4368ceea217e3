"""Policies by others: RAPTOR, and networks in ONNX whose inputs and outputs a TOML file tells."""
