"""What the scene node says of parameters that do nothing."""

from __future__ import annotations

from lime_planner.ros.nodes.scene_node import unused


def test_parameters_that_do_nothing_are_named() -> None:
    values = {"file": "plant.npz", "label_field": "label", "density": "dense"}
    given = ["file", "density", "label_field", "use_sim_time", "qos_overrides./leaf_cloud.publisher.depth", "rate", "leaf_labels"]
    assert unused(given, values) == [
        "density is not used: the scene comes from a file",
        "label_field is not used: it names a field of PLY and PCD files",
        "there is no parameter 'rate', its value is ignored; did you mean rate_hz?",
        "there is no parameter 'leaf_labels', its value is ignored; "
        "there are file, label_field, scale, offset, seed, density, target, approach, labelled, rate_hz, reliable, "
        "camera, camera_frame, camera_pose, viewpoints, robot, camera_noise_m, camera_drop_out",
    ]
    assert unused(["viewpoints"], {"file": ""}) == ["viewpoints is not used: it is about cameras, and camera is empty"]
    assert unused(["viewpoints"], {"file": "", "camera": "fixed"}) == []
    assert unused(["density", "seed"], {"file": ""}) == []
    assert unused(["label_field"], {"file": "scan.PLY"}) == []
