"""XLA compiles small programs in half the time, where it does not optimise them anyway."""

import jax
from jax._src import compiler  # JAX has no setting for options of all that is compiled

# Two thirds of all that the tests compile are single operations, for which the emitters of MLIR take twice as long as
# those before them; and few programs are worth being cut for several threads.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1}


def compile_hastily() -> None:
    """From now on, but for what is compiled within `keeping.optimising`."""
    options, quick = compiler.get_compile_options, None

    def with_quick(*args, env_options_overrides=None, **more):
        nonlocal quick
        if jax.config.read("jax_disable_most_optimizations"):
            if quick is None:  # not before: jaxrl_tab is to be imported when JAX has compiled nothing
                quick = {}  # with which is compiled what finds out
                quick = {name: value for name, value in QUICK.items() if _is_known(name)}
            env_options_overrides = quick | (env_options_overrides or {})
        return options(*args, env_options_overrides=env_options_overrides, **more)

    compiler.get_compile_options = with_quick


def _is_known(option: str) -> bool:
    """Whether this XLA has an option; that of JAX 0.12 has no other emitters any more."""
    try:
        jax.jit(lambda: 0).lower().compile({option: QUICK[option]})
    except jax.errors.JaxRuntimeError:
        return False
    return True
