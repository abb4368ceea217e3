"""Policies for other programs: ONNX, the authors' JSON and the Crazyflie app."""
