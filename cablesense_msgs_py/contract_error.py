"""The error of a message that breaks the contract."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class ContractError(CableSenseError):
    """A message that breaks the contract: says which field, its content, what would be right."""
