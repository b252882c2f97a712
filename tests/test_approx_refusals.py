"""What is refused of features and their methods, as the files of tests say it that are about these."""

import pytest
import test_approx
import test_approx_concatenate
import test_approx_networks
import test_approx_off_policy
import test_approx_optimizers
from refusals import refused

ABOUT = (
    test_approx,
    test_approx_concatenate,
    test_approx_networks,
    test_approx_off_policy,
    test_approx_optimizers,
)
REFUSED = [(message, refuse) for about in ABOUT for message, refuse in about.REFUSED.items()]


@pytest.mark.parametrize(("message", "refuse"), REFUSED, ids=[message for message, _ in REFUSED])
def test_it_is_refused_in_one_line(message, refuse):
    refused(refuse, message)
