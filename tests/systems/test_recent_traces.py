"""What caches of traces measure of their values."""

import ctypes

import casadi

from drake_nonstop.systems import recent_traces
from drake_nonstop.systems.recent_traces import LruCache, bytes_of


def test_functions_count_and_libraries_of_c_do_not():
    """Types of ctypes have each other as attributes, without an end."""
    library = ctypes.CDLL(None)
    library.abs.restype = ctypes.c_int
    x = casadi.SX.sym("x")
    function = casadi.Function("square", [x], [x * x])
    assert bytes_of([library, library.abs, function]) == bytes_of(function) > 0


def function(terms):
    x = casadi.SX.sym("x", terms)
    return casadi.Function("sines", [x], [casadi.sum1(casadi.sin(x))])


def test_all_caches_together_are_bounded_and_the_largest_loses_what_was_not_used(monkeypatch):
    monkeypatch.setattr(LruCache, "_all", [])
    monkeypatch.setattr(LruCache, "_new", 0.0)
    monkeypatch.setattr(recent_traces, "MOST_BYTES", 8.5 * bytes_of(function(100)))
    small, large = LruCache(), LruCache()
    small.get("kept", lambda: function(100))
    for key in range(6):
        large.get(key, lambda: function(100))
    first = large.get(0, list)  # it is used again
    assert len(large.entries) == 6
    for key in range(6, 12):
        large.get(key, lambda: function(100))
        assert large.get(0, list) is first
    assert [*small.entries] == ["kept"]
    assert [*large.entries][-2:] == [11, 0]
    held = [*small.entries.values(), *large.entries.values()]
    assert 0.7 < bytes_of(held) / recent_traces.MOST_BYTES <= 1


def test_one_value_beyond_the_bound_is_kept_until_the_next(monkeypatch):
    monkeypatch.setattr(LruCache, "_all", [])
    monkeypatch.setattr(recent_traces, "MOST_BYTES", 100)
    cache = LruCache()
    for key in range(3):
        made = cache.get(key, lambda: function(100))
        assert cache.get(key, list) is made
    assert [*cache.entries] == [2]
