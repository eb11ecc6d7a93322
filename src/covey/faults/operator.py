"""Who changes the mission while it runs: numbers landmarks and agents, and knows all that has changed."""

from __future__ import annotations

from covey.faults.scenario import Alteration, Kind, Scenario
from covey.protocol import EMPTY, AgentChange, Catalogue, LandmarkChange


class Operator:
    """The operator of one scenario.

    Parameters
    ----------
    scenario : Scenario
    """

    def __init__(self, scenario: Scenario) -> None:
        self.known = EMPTY
        """All that has changed."""
        self.pending = list(scenario.changes)
        self.joined = 0
        """How many agents have joined."""
        self.has_repeated = not scenario.changes
        """Whether it has told everything once more when the faults had stopped."""
        self._scenario = scenario
        self._added = 0

    def change(self, alteration: Alteration) -> Catalogue:
        """Change the mission; return the news."""
        version, number = self.known.version + 1, alteration.number
        kind, landmarks = alteration.kind, self._scenario.landmarks
        if kind is Kind.ADD:
            self._added += 1
            news = Catalogue({landmarks + self._added - 1: LandmarkChange(version, True, alteration.weight, 0.0, 0.0)})
        elif kind is Kind.JOIN:
            self.joined += 1
            news = Catalogue(agents={self._scenario.agents + self.joined - 1: AgentChange(version, True)})
        elif kind is Kind.LEAVE:
            news = Catalogue(agents={number: AgentChange(version, False)})
        else:
            alive = kind is Kind.REWEIGHT
            weight = alteration.weight if alive else 0.0
            news = Catalogue({number % landmarks: LandmarkChange(version, alive, weight, 0.0, 0.0)})
        self.known = self.known.merged(news)
        return news
