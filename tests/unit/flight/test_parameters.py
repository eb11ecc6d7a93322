"""Vehicle files: every value with a unit and a source, and what is told when one is wrong."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from covey.errors import InputError
from covey.flight import parameters
from covey.flight.layout import GRAVITY
from covey.flight.parameters import PARAMETERS, load_vehicle, vehicle_names

IRIS = (parameters.FOLDER / "iris.toml").read_text(encoding="utf-8")


def broken(tmp_path: Path, old: str, new: str) -> str:
    """What the loader says of the Iris+ with one text replaced."""
    assert old in IRIS
    path = tmp_path / "broken.toml"
    path.write_text(IRIS.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_vehicle(path)
    text = str(error.value)
    assert str(path) in text
    return text


@pytest.mark.parametrize("name", vehicle_names())
def test_each_value_has_a_unit_and_a_source(name: str) -> None:
    document = tomllib.loads((parameters.FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    assert document.pop("name") == name
    for section, table in document.items():
        for key, entry in table.items():
            assert set(entry) == {"value", "unit", "source"}, f"{section}.{key}"
            assert entry["unit"]
            assert len(entry["source"]) >= 6


@pytest.mark.parametrize("name", vehicle_names())
def test_mixer_agrees_with_the_geometry_and_hover_carries_the_weight(name: str) -> None:
    vehicle = load_vehicle(name)
    thrust = vehicle.thrust_coefficient * vehicle.hover_speed**2
    wrench = vehicle.mixer @ np.full(4, thrust)
    np.testing.assert_allclose(wrench, [vehicle.mass * GRAVITY, 0.0, 0.0, 0.0], atol=1e-12)
    row = vehicle.row()
    assert row.shape == (PARAMETERS,)
    inverse = row[parameters.ALLOCATION : parameters.ALLOCATION + 16].reshape(4, 4)
    np.testing.assert_allclose(vehicle.mixer @ inverse, np.eye(4), atol=1e-9)
    # a rotor on the left (y > 0) rolls to the right, one in front (x > 0) lifts the nose; torque is against spin
    for (x, y), spin, column in zip(vehicle.rotor_positions_B, vehicle.rotor_spins, vehicle.mixer.T, strict=True):
        assert math.copysign(1.0, column[1]) == math.copysign(1.0, y)
        assert math.copysign(1.0, column[2]) == -math.copysign(1.0, x)
        assert column[3] == -spin * vehicle.moment_ratio


def test_row_names_its_columns() -> None:
    vehicle = load_vehicle("iris")
    row = vehicle.row()
    expected = {
        parameters.MASS: 1.442,
        parameters.INERTIA + 2: 0.0977,
        parameters.ROTOR_XY + 3: 0.20,
        parameters.SPINS + 2: -1.0,
        parameters.THRUST_COEFFICIENT: 8.54858e-6,
        parameters.MOMENT_RATIO: 0.016,
        parameters.ROTOR_DRAG: 8.06428e-5,
        parameters.TAU_UP: 0.0125,
        parameters.TAU_DOWN: 0.025,
        parameters.SPEED_MAX: 838.0,
        parameters.BODY_DRAG + 2: 0.08,
        parameters.RADIUS: 0.38,
        parameters.HEIGHT: 0.11,
        parameters.RATE_GAINS + 2: vehicle.rate_gains[2],
        parameters.ROTOR_LEAD: vehicle.rotor_lead,
        parameters.ALPHA: vehicle.gains.alpha,
        parameters.GAMMA: vehicle.gains.gamma,
        parameters.K_YAW: vehicle.gains.k_yaw,
        parameters.MAX_TILT: math.pi / 4.0,
        parameters.MAX_YAW_RATE: math.radians(200.0),
        parameters.MAX_THRUST: vehicle.limits.max_thrust,
        parameters.MAX_JERK: vehicle.limits.max_jerk,
        parameters.MARGIN: vehicle.margin,
        parameters.VERTICAL_RATIO: vehicle.vertical_ratio,
        parameters.TILT_SLOPE: math.tan(parameters.TILT_RESERVE * math.pi / 4.0),
    }
    for column, value in expected.items():
        assert row[column] == value, column
    assert vehicle.required_separation == pytest.approx(2.0 * 0.38 + 0.2)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('unit = "kg"', 'unit = "g"', "body.mass: expected unit \"kg\", got 'g'"),
        ("value = 1.442", "value = -1.442", "body.mass: expected more than 0, got -1.442"),
        ("value = 1.442", 'value = "1.442"', "body.mass: expected"),
        ("value = 1.442", "value = nan", "body.mass: expected finite"),
        ("value = 1.442", "value = true", "body.mass: expected a number"),
        ("mass = {", "masss = {", "body.masss: unknown key (did you mean body.mass?)"),
        ("mass = {", "masss = {", "body.mass: missing; expected { value = ..., unit"),
        ("[0.0347563, 0.0458929, 0.0977]", "[0.0347563, 0.0458929]", "body.inertia: expected numbers of shape (3,)"),
        ('source = "Iris+ as flown in that laboratory, KTH"', 'source = " "', "body.mass: expected a source"),
        ("[1, 1, -1, -1]", "[1, 1, -1, 2]", "rotors.spins: expected 1 or -1"),
        ("[1, 1, -1, -1]", "[1, -1, 1, -1]", "rotors.positions: with these spins"),
        ("value = 838.0", "value = 600.0", "rotors.speed_max: expected rotors that lift the vehicle"),
        ("value = 60.0", "value = 900.0", "rotors.speed_min: expected less than rotors.speed_max"),
        ('value = 4.0, unit = "m/s^2"', 'value = 10.0, unit = "m/s^2"', "limits.max_thrust: expected gravity"),
        ("max_tilt = { value = 45.0", "max_tilt = { value = 95.0", "limits.max_tilt: expected less than 90 deg"),
        ("rotor_lead = { value = 1.0", "rotor_lead = { value = 0.5", "rate_loop.rotor_lead: expected 1 or more"),
        ("vertical_ratio = { value = 2.0", "vertical_ratio = { value = 0.5", "separation.vertical_ratio: expected 1"),
        ('name = "iris"', "name = 3", "name: expected a text, got 3"),
        ("[body]", "[body", "expected a TOML file"),
        ("mass = { value = 1.442,", "mass = 1.442 #", "body.mass: expected a table with value, unit and source"),
    ],
)
def test_mistakes_are_told_with_file_and_key(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert told in broken(tmp_path, old, new)


def test_an_endurance_may_be_unknown(tmp_path: Path) -> None:
    path = tmp_path / "older.toml"
    path.write_text(IRIS.partition("[battery]")[0], "utf-8")
    assert math.isnan(load_vehicle(path).endurance)
    assert load_vehicle("iris").endurance == 960.0
    assert "battery.endurance: expected more than 0" in broken(tmp_path, "value = 960.0", "value = 0.0")
    assert "did you mean battery.endurance?" in broken(tmp_path, "endurance = {", "endurnce = {")


def test_all_mistakes_at_once(tmp_path: Path) -> None:
    text = broken(tmp_path, 'mass = { value = 1.442, unit = "kg"', 'extra = 1\nmass = { value = 0.0, unit = "kg"')
    assert "body.extra" in text
    assert "body.mass" in text


def test_unknown_vehicles_and_files() -> None:
    with pytest.raises(InputError, match="did you mean iris"):
        load_vehicle("irs")
    with pytest.raises(InputError, match=r"none\.toml: expected a TOML file"):
        load_vehicle("none.toml")


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "heavy.toml"
    path.write_text(IRIS.replace("value = 1.442", "value = 1.5").replace('"iris"', '"heavy"'), encoding="utf-8")
    assert load_vehicle(path).mass == 1.5
    assert load_vehicle(str(path)).name == "heavy"
