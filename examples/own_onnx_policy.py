"""A network in ONNX flies, here one that `maidenflight export POLICY --to onnx` wrote.

On the command line, beside other policies and in this folder, by
`maidenflight transfer own_onnx_policy:Mine --reality virtual:7`.
"""

import numpy as np
import onnxruntime


class Mine:
    """Two instants of 20 numbers to four actions in [-1, 1], motors off to full thrust."""

    name, rate, command_rate = "mine", 100, 100  # set-points and commands a second

    def __init__(self, file="onnx_policy/policy.onnx"):
        """Reads the network."""
        self.network = onnxruntime.InferenceSession(file)

    def begin(self, hover, task):
        """Begins a flight; its last action is that of hover."""
        past, action = [], np.full(4, 2 * hover - 1)

        def fly(measurement, setpoint):
            nonlocal past, action
            position, velocity, quaternion, rates = map(np.asarray, measurement)
            error = setpoint - position
            now = np.concatenate([position, quaternion, velocity, rates, error, action])
            past = [past[-1] if past else now, now]
            observation = np.concatenate(past)[None].astype(np.float32)
            outputs = self.network.run(["action"], {"observation": observation})
            action = np.reshape(np.asarray(outputs[0]), 4)
            return (np.clip(action, -1, 1) + 1) / 2

        return fly
