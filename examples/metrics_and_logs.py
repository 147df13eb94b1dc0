"""Parameters, metrics and log messages of a run, while it goes on and afterwards."""

from __future__ import annotations

from dataclasses import dataclass

from ml_dash_mcap import Experiment, Recording


@dataclass
class Model:
    """What a dataclass holds becomes parameters."""

    layers: int = 4
    lr: float = 1e-3


with Experiment("examples/policy/metrics-and-logs", root=".dash", tags=["example"]).run as exp:
    exp.params.set(model=Model(), optimizer="adam")  # nested values get dotted names
    exp.params.set(optimizer="adamw")  # a later call adds to it
    print(f"parameters: {exp.params.get()}")

    exp.logs.info("training starts", epochs=3)
    for epoch in range(3):
        exp.metrics("train").log(loss=1.0 / (epoch + 1), epoch=epoch)
    exp.log("loss is still high", level="warn", loss=1 / 3)

    last = exp.metrics("train").read(limit=1000)["data"][-1]["data"]
    print(f"last point: epoch {last['epoch']}, loss {last['loss']:.3f}")

with Recording(exp.path) as recording:
    print(f"the run is {recording.run['status']}; its metrics: {list(recording.metrics)}")
    for message in recording.logs[-2:]:
        print(f"level {message['level']}: {message['message']} {message['metadata']}")
