"""Scores, the transfer of landmarks, and the equilibrium that a deployment is checked for."""

from covey.coverage.certificate import Certificate, LinkedPairs, TeamBound, Violation
from covey.coverage.score import agent_scores, team_visibility
from covey.coverage.transfer import transfer

__all__ = ["Certificate", "LinkedPairs", "TeamBound", "Violation", "agent_scores", "team_visibility", "transfer"]
