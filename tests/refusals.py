"""What is refused, for the tests of somebody's own classes and files."""

import pytest

from jaxrl_tab.core.errors import InputError


def refused(run, *messages):
    """The one line of the InputError that `run()` raises, in which all these messages stand."""
    with pytest.raises(InputError) as error:
        run()
    line = str(error.value)
    assert "\n" not in line
    for message in messages:
        assert message in line, line
    return line
