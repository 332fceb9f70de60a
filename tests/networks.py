"""Options of small networks, for tests."""

from zipf.agents.network_options import CompactOptions


def compact(patch=9, channels=8, size=16, head_size=0):
    """The compact network; codes and vectors get layers of the same sizes."""
    return CompactOptions(
        name="compact",
        patch=patch,
        channels=channels,
        size=size,
        code_channels=channels,
        code_size=size,
        vector_layers=[size],
        head_size=head_size,
    )
