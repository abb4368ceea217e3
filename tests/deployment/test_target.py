"""The exported C on an emulated STM32F405, the Crazyflie's processor: what it computes, what it
refuses, what it costs.

QEMU's `netduinoplus2` runs the flash image. It counts instructions and knows nothing of the
pipeline or of the flash's wait states, so what is held here is a number of instructions and not a
time.
"""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_c import STRICT, restless, walk

from maidenflight.deployment.c import export_c
from maidenflight.names import TRACKING
from maidenflight.policy import Policy
from maidenflight.simulator import environment
from maidenflight.simulator.controllers.control import CONTROLLERS
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead
from maidenflight.training.defaults import AHEAD, AHEAD_HIDDEN, DISTILLED_HIDDEN

HERE = Path(__file__).parent / "target"
TOOLS = (
    "arm-none-eabi-gcc",
    "arm-none-eabi-objcopy",
    "arm-none-eabi-nm",
    "arm-none-eabi-size",
    "qemu-system-arm",
)
MISSING = [name for name in TOOLS if not shutil.which(name)]
PROCESSOR = "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -ffreestanding".split()
"""The firmware's flags, and no library."""
EMULATOR = (
    "qemu-system-arm -M netduinoplus2 -display none -monitor none -serial null "
    "-semihosting-config enable=on,target=native -icount shift=0 -kernel image.bin"
).split()
FLASH_BEGIN = 0x08000000
OBSERVATIONS, HISTORIES, STEPS = 10_000, 4, 500
TICKS_PER_INSTRUCTION = 0.168
"""With `-icount shift=0` an instruction takes 1 ns of the emulator's time, and SysTick counts 168
MHz."""
MEMORY = 16
"""Numbers that the policy with a memory remembers."""
INSTRUCTIONS = {0: 16_000, MEMORY: 20_000}
"""Bar of a whole step, the network and what stands around it, by the size of the memory."""
FLASH, RAM = {0: 24_000, MEMORY: 28_000}, {0: 2_000, MEMORY: 2_800}
"""Bars of the object [bytes], weights included, and of its variables, its state and its stack."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"not on this machine: {', '.join(MISSING)}"),
]


class SimulatedFlight(NamedTuple):
    """What Python and the board made of the same observations and histories; actions
    (10_000, 4 + M), the rest (4, 500, ...)."""

    actions: np.ndarray
    history: np.ndarray
    action: np.ndarray
    command: np.ndarray


class Board(NamedTuple):
    """A folder with the built object and image, what was computed there, and what Python
    computes."""

    folder: Path
    board: SimulatedFlight
    python: SimulatedFlight
    costs: np.ndarray
    """As written by `main.c`."""
    memory: int


def built(policy: Policy, folder: Path) -> None:
    """Writes `policy.o`, `image.elf` and `image.bin`."""
    export_c(policy, folder)
    compiler = ("arm-none-eabi-gcc", *PROCESSOR, "-Os")
    linking = ("-nostdlib", "-T", HERE / "stm32f405.ld", "-o", "image.elf")
    plain = (
        "-std=gnu11",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-fno-tree-loop-distribute-patterns",
        f"-DSTEPS={STEPS}",
        "-I.",
    )
    for command in (
        (*compiler, *STRICT, "-c", "policy.c"),
        (*compiler, *plain, HERE / "startup.c", HERE / "main.c", "policy.o", *linking),
        ("arm-none-eabi-objcopy", "-O", "binary", "image.elf", "image.bin"),
    ):
        found = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert (found.returncode, found.stderr) == (0, ""), command


def output_of(folder: Path, *command: str) -> str:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout


def run(folder: Path) -> bool:
    """Boots `image.bin`; whether its self test passed."""
    found = subprocess.run(EMULATOR, cwd=folder, capture_output=True, text=True, timeout=120)
    assert (found.returncode, found.stderr) == (0, "")
    return np.fromfile(folder / "verdict", np.uint32).tolist() == [1]


def flown_in_python(
    policy: Policy,
    observations: np.ndarray,
    last: np.ndarray,
    moments: Measurement,
    setpoints: jax.Array,
    ahead: np.ndarray,
) -> SimulatedFlight:
    """All histories at once, each step from what the step before remembered."""
    act, observe = jax.jit(jax.vmap(policy)), jax.jit(jax.vmap(environment.observe))
    commands = policy.interface
    memory, action, flown = None, jnp.asarray(last), []
    remembered = jnp.zeros((len(last), policy.spec.memory))
    for step in range(STEPS):
        now = Measurement(*(part[:, step] for part in moments))
        instant = np.asarray(observe(now, setpoints[:, step], action))[:, None]
        memory = (
            np.repeat(instant, policy.spec.history, axis=1)
            if memory is None
            else np.concatenate([memory[:, 1:], instant], axis=1)
        )
        points = (ahead[:, step] - np.asarray(now.position)[:, None]).reshape(len(memory), -1)
        seen = np.concatenate([memory.reshape(len(memory), -1), points], axis=1)
        observation = jnp.concatenate([seen, remembered], axis=1)
        action, remembered = jnp.split(act(observation), [4], axis=1)
        command = np.array(commands.centre) + np.array(commands.span) * np.clip(action, -1, 1)
        flown.append((np.concatenate([seen, remembered], axis=1), action, command))
    return SimulatedFlight(
        np.asarray(jax.vmap(policy)(jnp.asarray(observations))),
        *(np.stack(part, axis=1) for part in zip(*flown, strict=True)),
    )


@pytest.fixture(scope="module", params=[*CONTROLLERS, "memory", TRACKING])
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Board:
    """A policy of the usual layers, flown on the board and in Python."""
    folder, random = tmp_path_factory.mktemp(request.param), np.random.default_rng(1)
    memory = MEMORY if request.param == "memory" else 0
    structure = request.param if request.param in CONTROLLERS else "pwm"
    # Of distillation, and of training by gradients.
    spec = PolicySpec(memory=memory, hidden=DISTILLED_HIDDEN) if memory else PolicySpec()
    if request.param == TRACKING:
        spec = PolicySpec(look_ahead=LookAhead(AHEAD), hidden=AHEAD_HIDDEN)
    policy = restless(spec, CONTROLLERS[structure]().interface)
    built(policy, folder)
    spread = random.normal(size=(OBSERVATIONS, len(policy.observation_mean)))
    instants = np.asarray(policy.observation_mean) + np.asarray(policy.observation_std) * spread
    remembered = random.uniform(-1, 1, (OBSERVATIONS, memory))
    observations = np.concatenate([instants, remembered], axis=1).astype(np.float32)
    last = random.uniform(-1, 1, (HISTORIES, 4)).astype(np.float32)
    walks = [walk(STEPS, seed) for seed in range(HISTORIES)]
    moments = Measurement(
        *(
            jnp.array([[moment[place] for moment in moments] for moments, _ in walks])
            for place in range(4)
        )
    )
    setpoints = jnp.array([points for _, points in walks])
    ahead = random.normal(size=(HISTORIES, STEPS, spec.look_ahead.points, 3)).astype(np.float32)
    seen = np.concatenate(
        [
            *(moments.position, moments.quaternion, moments.velocity, moments.body_rates),
            *(setpoints, ahead.reshape(HISTORIES, STEPS, -1)),
        ],
        axis=-1,
    )
    (folder / "observations").write_bytes(observations.tobytes())
    (folder / "histories").write_bytes(
        np.hstack([last, seen.reshape(HISTORIES, -1)]).astype(np.float32).tobytes()
    )
    assert run(folder)
    actions = np.fromfile(folder / "actions", np.float32).reshape(OBSERVATIONS, -1)
    steps = np.fromfile(folder / "flown", np.float32).reshape(HISTORIES, STEPS, -1)
    board = SimulatedFlight(actions, *np.split(steps, [spec.size, spec.size + 4], axis=-1))
    return Board(
        folder,
        board,
        flown_in_python(policy, observations, last, moments, setpoints, ahead),
        np.fromfile(folder / "costs", np.uint32),
        memory,
    )


def test_the_board_computes_and_remembers_what_python_does(flown: Board):
    for name, board, python in zip(SimulatedFlight._fields, flown.board, flown.python, strict=True):
        np.testing.assert_allclose(board, python, rtol=0, atol=1e-5, err_msg=name)
    assert np.abs(flown.python.action).max() > 1.0
    assert np.std(flown.python.action, axis=(0, 1)).min() > 0.1


def test_a_step_stays_within_its_instructions_flash_and_memory(flown: Board):
    loop, calls, network, step, state, stack_of_step, stack_of_self_test = flown.costs.tolist()
    assert loop == pytest.approx(200_000 * TICKS_PER_INSTRUCTION, rel=1e-4)
    network, step = (ticks / TICKS_PER_INSTRUCTION / calls for ticks in (network, step))
    sizes = output_of(flown.folder, "arm-none-eabi-size", "policy.o").splitlines()[1]
    text, data, bss = map(int, sizes.split()[:3])
    stack = max(stack_of_step, stack_of_self_test)
    print(
        f"network {network:.1f}, step {step:.1f} instructions; text {text}, data {data}, bss "
        f"{bss}, state {state}, stack {stack} bytes"
    )
    assert network < step <= INSTRUCTIONS[flown.memory]
    assert text + data <= FLASH[flown.memory]
    assert data + bss + state + stack <= RAM[flown.memory]


def test_the_object_needs_no_library(flown: Board):
    assert output_of(flown.folder, "arm-none-eabi-nm", "-u", "policy.o") == ""


@pytest.fixture
def damaged(flown: Board, tmp_path: Path) -> Callable[[str], bool]:
    """Boots the image with the last bit of a table's first number turned; whether the self test
    passed."""
    symbols = output_of(flown.folder, "arm-none-eabi-nm", "image.elf").splitlines()
    addresses = {name: int(address, 16) for address, _, name in map(str.split, symbols)}
    image = (flown.folder / "image.bin").read_bytes()

    def passes(table: str) -> bool:
        place = addresses[table] - FLASH_BEGIN
        turned = bytes([image[place] ^ 1])
        (tmp_path / "image.bin").write_bytes(image[:place] + turned + image[place + 1 :])
        return run(tmp_path)

    return passes


@pytest.mark.parametrize("table", ["deviation", "weights_1", "biases_3"])
def test_an_image_with_one_bit_turned_is_refused(damaged: Callable[[str], bool], table: str):
    assert not damaged(table)
