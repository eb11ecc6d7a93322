"""The flights of chapters 2 and 3 of the thesis; ``examples/exercises`` has the same as files with comments."""

from __future__ import annotations

from covey.mission.exercise import Exercise, parse_exercise

SCENES = {
    "regulation": """
  duration_s: 10
  vehicles:
    - {name: quad, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 1, y_m: 3, z_m: 2, direct: true}}
""",
    "circle": """
  duration_s: 20
  vehicles:
    - name: quad
      start: {x_m: 0, y_m: 0, z_m: 0.5}
      circle: {radius_m: 1, rate_rad_s: -1, altitude_m: 0.5}
""",
    "leader-follower": """
  duration_s: 45
  vehicles:
    - name: leader
      start: {x_m: 1.5, y_m: 0, z_m: 1.5}
      circle: {radius_m: 1.5, rate_rad_s: 0.3, altitude_m: 1.5}
    - name: follower
      start: {x_m: 1.5, y_m: -1.5, z_m: 1.5}
      follow: {leader: leader, offset_m: [0, -1.5, 0]}
""",
    "attraction": """
  duration_s: 15
  vehicles:
    - {name: quad, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 1, y_m: 3, z_m: 2}}
  navigation: {k_wp: 5, k_v: 5}
""",
    "go-to-two": """
  duration_s: 40
  vehicles:
    - {name: quad 1, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 2, y_m: 2, z_m: 2}}
    - {name: quad 2, start: {x_m: 2, y_m: 0, z_m: 1}, goal: {x_m: 0, y_m: 2, z_m: 2}}
  navigation: {k_wp: 1, k_v: 5, k_rep: 2, threshold_m: 1.5}
""",
    "go-to-three": """
  duration_s: 50
  vehicles:
    - {name: quad 1, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 0, y_m: 3, z_m: 3}}
    - {name: quad 2, start: {x_m: 2, y_m: 0, z_m: 1}, goal: {x_m: -2, y_m: 3, z_m: 3}}
    - {name: quad 3, start: {x_m: -2, y_m: 0, z_m: 1}, goal: {x_m: 2, y_m: 3, z_m: 3}}
  navigation: {k_wp: 1, k_v: 5, k_rep: 3, threshold_m: 1.5}
""",
    "swap": """
  duration_s: 40
  vehicles:
    - {name: quad 1, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 2, y_m: 0, z_m: 1}}
    - {name: quad 2, start: {x_m: 2, y_m: 0, z_m: 1}, goal: {x_m: 0, y_m: 0, z_m: 1}}
  navigation: {k_wp: 1, k_v: 5, k_rep: 2, threshold_m: 1.5}
""",
    "hover": """
  duration_s: 60
  vehicles:
    - {name: quad, start: {x_m: 0, y_m: 0, z_m: 1.2}, hold: true}
  objects:
    - {name: stick, radius_m: 0.1, path_m: [[-3, 0.1, 1.2], [3, 0.1, 1.2]], speed_m_s: 0.3, start_s: 2}
  navigation: {k_wp: 1, k_v: 5, k_rep: 1, threshold_m: 1}
""",
}
"""What stands under ``exercise`` in each file, by name."""


def scene(name: str) -> Exercise:
    """Return one of `SCENES`.

    Examples
    --------
    >>> [vehicle.name for vehicle in scene("swap").vehicles]
    ['quad 1', 'quad 2']
    """
    return parse_exercise(f"schema_version: 1\nname: {name}\nexercise:{SCENES[name]}", source=name)
