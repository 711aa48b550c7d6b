"""The pose of a hand-held instrument under a tracker, from FMUs, as `steadytip run` shows it."""

import numpy as np
import pytest

import steadytip as st


@pytest.mark.slow
def test_pose_tracking_bridges_occlusions_and_knows_how_well(tmp_path) -> None:
    """60 Hz, 16 ms late, six random occlusions a minute: a tenth of a millimetre, 0.03 deg."""
    result = st.run("pose_tracking", out=tmp_path, report=False)
    value = {name: metric.value for name, metric in result.metrics.items()}
    assert np.degrees(value["attitude_error_rms"]) < 0.03
    assert value["position_error_rms"] < 1e-4
    assert value["position_error_max"] < 1e-3
    assert 0.8 < value["estimator.nis"] < 1.2
    assert 0.5 < value["estimator.attitude_nees"] < 1.5
    assert 0.2 < value["estimator.position_nees"] < 1.5
    after = result.time > 1.0
    assert result.signals("estimator.valid")[after].all()
    assert result.signals("estimator.optical_lost")[after].any()
    sizes = set(result.signals("estimator.innovation_size"))
    assert {0.0, 6.0} < sizes, "some poses came as single markers"
