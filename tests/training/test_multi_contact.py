"""The two-stage multi-contact network: its verdict on every segment joins stage two."""

import torch

from cablesense_training.networks.multi_contact import TwoStageMultiContactNetwork


def test_stage_two_sees_which_segments_stage_one_found():
    torch.manual_seed(0)
    network = TwoStageMultiContactNetwork(12, 4, contact_widths=(16,), widths=(16,))
    seen = []
    network.trunk.register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    x = torch.randn(9, 12)
    output = network(x)
    torch.testing.assert_close(seen[0][:, :12], x)
    assert seen[0][:, 12:].tolist() == (output.contact_logits > 0).float().tolist()


def test_segments_are_judged_independently():
    network = TwoStageMultiContactNetwork(12, 4, contact_widths=(16,), widths=(16,))
    with torch.no_grad():
        network.contact_head.weight.zero_()
        network.contact_head.bias.copy_(torch.tensor([5.0, -5.0, 5.0, 5.0]))
        found = network(torch.randn(3, 12)).contact_logits > 0
    assert found.tolist() == [[True, False, True, True]] * 3
