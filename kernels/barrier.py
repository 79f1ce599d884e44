"""CPU cores that run a graph together: where they wait for each other."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
#if defined(_WIN32)
#define GIVE_WAY()
#else
    int give_way(void) __asm__("sched_yield");
#define GIVE_WAY() give_way()
#endif
    unsigned* arrived = (unsigned*)gate.data;
    unsigned* opened = arrived + 16;
    const unsigned before = __atomic_load_n(opened, __ATOMIC_RELAXED);
    if (__atomic_add_fetch(arrived, 1u, __ATOMIC_ACQ_REL) == (unsigned)lanes)
    {
        __atomic_store_n(arrived, 0u, __ATOMIC_RELAXED);
        __atomic_store_n(opened, before + 1u, __ATOMIC_RELEASE);
    }
    else
        for (int turn = 0; __atomic_load_n(opened, __ATOMIC_ACQUIRE) == before; ++turn)
        {
#if defined(__x86_64__)
            __builtin_ia32_pause();
#endif
            if (turn > 2000)
                GIVE_WAY();
        }
#endif
""")
def wait_for_all(gate: wp.array(dtype=wp.uint32), lanes: int):
    """Return once all lanes are here. `gate` holds how many are, and in another cache line how often it opened.

    A lane spins, as what it waits for takes microseconds; when it takes longer, another process is given the core.
    """
    ...


@wp.kernel
def meet(gate: wp.array(dtype=wp.uint32), lanes: int):
    """Wait until all lanes are here. [32]."""
    wait_for_all(gate, lanes)
