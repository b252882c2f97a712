"""From LLVM IR to a function that can be called."""

import ctypes
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from jaxrl_tab.lanes.emit import Emitter
from jaxrl_tab.lanes.lower import lower


class Kernel:
    def __init__(self, emitter: Emitter, text: str, cpu: str | None = None, features: str | None = None):
        t = [time.process_time()]
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        module = llvm.parse_assembly(text)
        module.verify()
        t.append(time.process_time())
        machine = llvm.Target.from_default_triple().create_target_machine(
            cpu=cpu or llvm.get_host_cpu_name(), features=features or llvm.get_host_cpu_features().flatten(), opt=int(__import__("os").environ.get("CG","2")), jit=True
        )
        options = llvm.create_pipeline_tuning_options(speed_level=int(__import__("os").environ.get("SL","2")))
        options.loop_unrolling = options.slp_vectorization = options.loop_vectorization = False
        passes = llvm.create_pass_builder(machine, options)
        passes.getModulePassManager().run(module, passes)
        t.append(time.process_time())
        self.module, self.machine = module, machine
        self.engine = llvm.create_mcjit_compiler(module, machine)
        self.engine.finalize_object()
        t.append(time.process_time())
        self.seconds = dict(zip(("parse", "passes", "code"), np.diff(t).round(3), strict=True))
        self.function = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 3)(
            self.engine.get_function_address("kernel")
        )
        self.lanes, self.scratch = emitter.lanes, emitter.scratch
        self.inputs = [(b.size, b.dtype) for b in emitter.code.inputs]
        self.outputs = [(b.size, b.dtype) for b in emitter.code.outputs]
        self.tables = [np.ascontiguousarray(b.known.view(np.uint8) if b.known.dtype == bool else b.known) for b in emitter.tables]
        self.pool: dict[int, ThreadPoolExecutor] = {}

    def __call__(self, n: int, *arrays: Any, threads: int = 1) -> list[np.ndarray]:
        assert n % self.lanes == 0
        given = [np.ascontiguousarray(np.broadcast_to(np.asarray(x, dt), (n, size) if size > 1 else (n,))) for x, (size, dt) in zip(arrays, self.inputs, strict=True)]
        outs = [np.empty((n, size), dt) for size, dt in self.outputs]
        pointers = lambda xs: (ctypes.c_void_p * max(len(xs), 1))(*[x.ctypes.data for x in xs])
        arguments, tables = pointers([*given, *outs]), pointers(self.tables)
        blocks, lock, following = n // self.lanes, threading.Lock(), iter(range(n // self.lanes))

        def work() -> None:
            raw = np.zeros(self.scratch + 8192, np.uint8)
            base = -(-raw.ctypes.data // 4096) * 4096
            while True:
                with lock:
                    b = next(following, blocks)
                if b >= blocks:
                    return
                self.function(b, b + 1, base, arguments, tables)

        if threads == 1:
            work()
        else:
            pool = self.pool.setdefault(threads, ThreadPoolExecutor(threads))
            for future in [pool.submit(work) for _ in range(threads)]:
                future.result()
        return outs


def compile(closed: Any, varying: Any, given: Any, width: int = 16, groups: int = 8, **options: Any) -> Kernel:
    begun = time.process_time()
    code = lower(closed, varying, given)
    lowered = time.process_time()
    emitter = Emitter(code, width, groups, **options)
    text = emitter.kernel()
    emitted = time.process_time()
    open("/tmp/kernel.ll", "w").write(text)
    kernel = Kernel(emitter, text)
    kernel.seconds |= {"lower": round(lowered - begun, 3), "emit": round(emitted - lowered, 3)}
    return kernel
