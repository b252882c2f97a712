import os
os.environ.setdefault("XLA_FLAGS","--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000")
from jaxrl_tab.algorithms import *
from jaxrl_tab.envs import *
from jaxrl_tab.train import train
