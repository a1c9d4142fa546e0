import sys
from threading import Thread

import numpy as np
from rsmcm.models.numerics import array_pool


def test_an_array_in_use_is_not_handed_out():
    held = [array_pool.empty((3, 5), np.float32) for _ in range(30)]
    assert len({array.ctypes.data for array in held}) == 30


def test_a_view_keeps_the_array():
    array = array_pool.empty((41,), np.float64)
    address = array.ctypes.data
    view = array.reshape(1, -1)[:, 3:7]
    del array
    others = [array_pool.empty((41,), np.float64) for _ in range(20)]
    assert address not in {other.ctypes.data for other in others}
    assert view.shape == (1, 4)


def test_an_array_that_nobody_holds_is_used_again():
    addresses = set()
    for _ in range(50):
        array = array_pool.empty((7, 43), np.int8)
        addresses.add(array.ctypes.data)
        del array
    assert len(addresses) == 1


def test_shape_and_type_are_those_asked_for():
    for shape, dtype in (((2, 3), np.uint8), ((2, 3), np.int8), ((3, 2), np.uint8), ((6,), "f4")):
        array = array_pool.empty(shape, dtype)
        assert array.shape == shape
        assert array.dtype == np.dtype(dtype)


def test_many_threads_never_share_an_array():
    clashes = []

    def work(number):
        for _ in range(300):
            array = array_pool.empty((64,), np.int64)
            array[:] = number
            if not (array == number).all():
                clashes.append(number)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [Thread(target=work, args=(k,)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not clashes
