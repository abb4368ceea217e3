"""Training in programs by others: TensorBoard, and Weights & Biases."""
