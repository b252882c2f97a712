"""XLA compiles small programs in half the time, where it does not optimise them anyway."""

import jax
from jax._src import compiler  # JAX has no setting for options of all that is compiled

# Two thirds of all that the tests compile are single operations, for which the emitters of MLIR take twice as long as
# those before them; and few programs are worth being cut for several threads.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1}


def compile_hastily() -> None:
    """From now on, but for what is compiled within `keeping.optimising`."""
    options = compiler.get_compile_options

    def with_quick(*args, env_options_overrides=None, **more):
        if jax.config.read("jax_disable_most_optimizations"):
            env_options_overrides = QUICK | (env_options_overrides or {})
        return options(*args, env_options_overrides=env_options_overrides, **more)

    compiler.get_compile_options = with_quick
