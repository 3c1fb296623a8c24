"""The networks: raw tension differences in, contacts and forces with their uncertainty out."""

from cablesense_training.networks.multi_contact import MultiContactNetwork
from cablesense_training.networks.single_contact import SingleContactNetwork

Network = SingleContactNetwork | MultiContactNetwork

__all__ = ["MultiContactNetwork", "Network", "SingleContactNetwork"]
