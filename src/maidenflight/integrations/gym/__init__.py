"""The drone as Gymnasium environments, one and many at a time.

Importing this package registers them and imports no JAX. Gymnasium does it by itself where the id
names the package: `gymnasium.make("maidenflight.integrations.gym:maidenflight/Circle-v0")`.
"""

from importlib.util import find_spec

from maidenflight.errors import optional

TASKS = {"Hover": "hover", "Circle": "circle", "TakeOff": "take_off", "Tracking": "tracking"}
"""Name in an environment's id to name of the task."""


def register() -> None:
    """Registers `maidenflight/Hover-v0`, `Circle-v0`, `TakeOff-v0` and `Tracking-v0` once.

    Raises:
        InputError: Gymnasium or Pillow is not installed.
    """
    with optional("gymnasium", "gym", __name__):
        from gymnasium.envs import registration
    with optional("pillow", "gym", __name__):
        if find_spec("PIL") is None:
            raise ImportError
    for name, task in TASKS.items():
        if f"maidenflight/{name}-v0" not in registration.registry:
            registration.register(
                f"maidenflight/{name}-v0",
                entry_point="maidenflight.integrations.gym.single:QuadrotorEnv",
                vector_entry_point="maidenflight.integrations.gym.vector:QuadrotorVectorEnv",
                kwargs={"task": task},
                # Each step's check would cost as much as the step; the tests check all
                # environments.
                disable_env_checker=True,
            )


register()
