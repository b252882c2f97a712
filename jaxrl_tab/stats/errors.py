"""What is said of the errors of V at the end; where it is linear in features, beside what these allow."""

from jaxrl_tab.stats.column import Column
from jaxrl_tab.stats.intervals import mean_interval

ERRORS = [
    Column(
        "final_v_error",
        lambda own: None if (x := own.at_the_end("v_error")) is None else mean_interval(x).estimate,
        screen="RMS error\nat the end",
        report="error at the end",
    ),
    Column(
        "final_value_error",
        lambda own: None if (x := own.at_the_end("value_error")) is None else mean_interval(x).estimate,
        report="√VE at the end",
        help="the root of the mean squared error of V, weighted by how often the policy that acts is in each state; "
        "mean over seeds.",
    ),
    Column(
        "least_value_error",
        lambda own: own.ds.get("least_value_error"),
        report="least √VE",
        help="of all that the features can express.",
    ),
    Column(
        "td_value_error",
        lambda own: own.ds.get("td_value_error"),
        report="√VE of TD",
        help="that of the fixed point of semi-gradient TD.",
    ),
]
