"""The paper, reproduced: every study, table and figure, in one report."""
