"""The laboratory: joins agents and environments into runs, evaluations and reports."""
