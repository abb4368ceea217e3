"""Training and flights in programs by others: TensorBoard, Weights & Biases and rerun."""
