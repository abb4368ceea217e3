"""A network of dense layers as a TensorFlow Lite model, without TensorFlow.

Needs `tflite`, the schema's accessors in Python, which the extra `px4` brings. Layers are the
operator FULLY_CONNECTED, with ReLU fused into all but the last; PX4's module knows it.

Source: TensorFlow Lite, schema.fbs (version 3, identifier TFL3).
"""

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maidenflight.errors import optional

VERSION = 3
"""Of the schema, by its specification."""
IDENTIFIER = b"TFL3"
ALIGNMENT = 16
"""Of a buffer's data [bytes], by the schema's specification."""
Layer = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Weights, (outputs, inputs), and biases, (outputs,)."""


def to_tflite(layers: Sequence[Layer], description: str) -> bytes:
    """Returns the model: an input (1, inputs) and an output (1, outputs), float32.

    Args:
        layers: in order.
        description: text in the model.

    Raises:
        InputError: `tflite` is not installed.
    """
    with optional("tflite", "px4", "a network for PX4"):
        schema: Any = importlib.import_module("tflite")
        builder: Any = importlib.import_module("flatbuffers").Builder(1 << 16)
    buffers = [_buffer(schema, builder, b"")]
    tensors = [_tensor(schema, builder, "input", (1, layers[0][0].shape[1]), 0)]
    operators = []
    for number, layer in enumerate(layers):
        is_last = number == len(layers) - 1
        places = [len(tensors) - 1]
        for name, table in zip(("weights", "biases"), layer, strict=True):
            places.append(len(tensors))
            label = f"{name}_{number}"
            tensors.append(_tensor(schema, builder, label, table.shape, len(buffers)))
            buffers.append(_buffer(schema, builder, np.ascontiguousarray(table, "<f4").tobytes()))
        output = "output" if is_last else f"values_{number}"
        tensors.append(_tensor(schema, builder, output, (1, len(layer[1])), 0))
        operators.append(_dense(schema, builder, places, len(tensors) - 1, relu=not is_last))
    graph = _graph(schema, builder, tensors, operators)
    text = builder.CreateString(description)
    code = _operator_code(schema, builder)
    vectors = [_references(builder, offsets) for offsets in ([code], [graph], buffers)]
    schema.ModelStart(builder)
    schema.ModelAddVersion(builder, VERSION)
    schema.ModelAddOperatorCodes(builder, vectors[0])
    schema.ModelAddSubgraphs(builder, vectors[1])
    schema.ModelAddDescription(builder, text)
    schema.ModelAddBuffers(builder, vectors[2])
    builder.Finish(schema.ModelEnd(builder), file_identifier=IDENTIFIER)
    return bytes(builder.Output())


def _references(builder: Any, places: Sequence[int]) -> int:
    """A vector of tables."""
    builder.StartVector(4, len(places), 4)
    for offset in reversed(places):
        builder.PrependUOffsetTRelative(offset)
    return builder.EndVector()


def _integers(builder: Any, values: Sequence[int]) -> int:
    return builder.CreateNumpyVector(np.asarray(values, np.int32))


def _buffer(schema: Any, builder: Any, data: bytes) -> int:
    vector = None
    if data:
        builder.StartVector(1, len(data), ALIGNMENT)
        builder.head -= len(data)
        builder.Bytes[builder.head : builder.head + len(data)] = data
        vector = builder.EndVector()
    schema.BufferStart(builder)
    if vector is not None:
        schema.BufferAddData(builder, vector)
    return schema.BufferEnd(builder)


def _tensor(schema: Any, builder: Any, name: str, shape: Sequence[int], buffer: int) -> int:
    text, sizes = builder.CreateString(name), _integers(builder, shape)
    schema.TensorStart(builder)
    schema.TensorAddShape(builder, sizes)
    schema.TensorAddType(builder, schema.TensorType.FLOAT32)
    schema.TensorAddBuffer(builder, buffer)
    schema.TensorAddName(builder, text)
    return schema.TensorEnd(builder)


def _dense(schema: Any, builder: Any, inputs: Sequence[int], output: int, relu: bool) -> int:
    """An operator of one layer; inputs are places of values, weights and biases."""
    activations = schema.ActivationFunctionType
    schema.FullyConnectedOptionsStart(builder)
    schema.FullyConnectedOptionsAddFusedActivationFunction(
        builder, activations.RELU if relu else activations.NONE
    )
    options = schema.FullyConnectedOptionsEnd(builder)
    sources, targets = _integers(builder, inputs), _integers(builder, [output])
    schema.OperatorStart(builder)
    schema.OperatorAddOpcodeIndex(builder, 0)
    schema.OperatorAddInputs(builder, sources)
    schema.OperatorAddOutputs(builder, targets)
    schema.OperatorAddBuiltinOptionsType(builder, schema.BuiltinOptions.FullyConnectedOptions)
    schema.OperatorAddBuiltinOptions(builder, options)
    return schema.OperatorEnd(builder)


def _graph(schema: Any, builder: Any, tensors: Sequence[int], operators: Sequence[int]) -> int:
    vectors = [_references(builder, offsets) for offsets in (tensors, operators)]
    ends = [_integers(builder, [index]) for index in (0, len(tensors) - 1)]
    schema.SubGraphStart(builder)
    schema.SubGraphAddTensors(builder, vectors[0])
    schema.SubGraphAddInputs(builder, ends[0])
    schema.SubGraphAddOutputs(builder, ends[1])
    schema.SubGraphAddOperators(builder, vectors[1])
    return schema.SubGraphEnd(builder)


def _operator_code(schema: Any, builder: Any) -> int:
    dense = schema.BuiltinOperator.FULLY_CONNECTED
    schema.OperatorCodeStart(builder)
    schema.OperatorCodeAddDeprecatedBuiltinCode(builder, dense)
    schema.OperatorCodeAddVersion(builder, 1)
    schema.OperatorCodeAddBuiltinCode(builder, dense)
    return schema.OperatorCodeEnd(builder)
