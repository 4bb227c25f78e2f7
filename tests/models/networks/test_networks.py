"""What tiling relies on: bounded neighbourhoods, no checkerboard, and sane values on hard inputs."""

from __future__ import annotations

import math

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor, nn  # noqa: E402

from models.colour import linear, srgb  # noqa: E402
from models.networks.configs import CONTEXT_CHANNELS, Zeta, build, parameters  # noqa: E402
from models.networks.context import filled  # noqa: E402
from models.networks.stages import StageNet  # noqa: E402
from models.networks.translator import Stem  # noqa: E402

pytestmark = pytest.mark.train

STAGES = ("delta", "delta_blind", "psi", "rho", "sigma")


def stage(name: str) -> StageNet:
    """A slim stage whose output really depends on its body: heads begin nearly mute."""
    torch.manual_seed(3)
    network = build(name, "slim")
    assert isinstance(network, StageNet)
    for part in network.modules():
        if isinstance(part, nn.Conv2d):
            nn.init.normal_(part.weight, std=1.5 / (part.weight[0].numel() ** 0.5))
    network.double().eval()
    return network


def maps(network: StageNet, height: int, width: int) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(1, len(network.channels), height, width, generator=generator, dtype=torch.float64) * 2 - 1


@pytest.mark.parametrize("name", STAGES)
def test_nothing_beyond_the_halo_matters(name: str) -> None:
    """Were the halo too small, tiles would differ from the whole along their borders."""
    network = stage(name)
    halo, stride = network.halo(), network.stride
    side = 2 * halo + 4 * stride
    x = maps(network, side, side)
    inner = slice(halo, side - halo)
    with torch.no_grad():
        whole = network(x)
        far = x.clone()
        far[..., :, :1] += 0.7  # one halo away from the inner part
        far[..., :1, :] -= 0.7
        assert torch.equal(network(far)[..., inner, inner], whole[..., inner, inner])
        near = x.clone()
        near[..., :, halo - 1] += 0.7
        assert not torch.allclose(network(near)[..., inner, inner], whole[..., inner, inner], atol=1e-9)


@pytest.mark.parametrize("name", STAGES)
def test_halo_is_not_much_wider_than_the_reach(name: str) -> None:
    """A halo far too wide would cost time in every tile."""
    network = stage(name)
    side = 2 * network.halo() + 4 * network.stride
    x = maps(network, side, side).requires_grad_(True)
    middle = side // 2
    network(x)[..., middle, middle].sum().backward()
    reached = (x.grad.abs().sum((0, 1, 2)) > 0).nonzero().flatten()
    reach = max(middle - int(reached.min()), int(reached.max()) - middle)
    assert reach <= network.halo() <= reach + 4 * network.stride


@pytest.mark.parametrize("whole", [0, 1])
def test_one_strided_convolution_equals_unshuffle_mean_and_convolution(whole: int) -> None:
    """Also at the border, where a kernel that was put together wrongly by one texel would see other zeros."""
    torch.manual_seed(0)
    stem = Stem(detail=3, slow=4, width=5, whole=whole).double()
    x = torch.rand(2, 7, 12, 20, dtype=torch.float64) - 0.3
    parts = [nn.functional.pixel_unshuffle(x[:, :3], 2), nn.functional.avg_pool2d(x[:, 3:], 2)]
    expected = nn.functional.conv2d(torch.cat(parts, 1), stem.weight, stem.bias, padding=1)
    assert torch.allclose(stem(stem.packed(x)), expected, atol=1e-12)


def test_paper_has_the_published_number_of_parameters() -> None:
    """RCAN 10 x 20 has 15.7 million (method: 15.74 million with 64 features)."""
    zeta = build("zeta", "paper")
    assert isinstance(zeta, Zeta)
    assert 15.0e6 < parameters(zeta) < 16.5e6


@pytest.mark.parametrize("name", STAGES)
@pytest.mark.parametrize("value", [-1.0, 1.0, 0.0])
def test_constant_inputs_give_finite_values_in_range(name: str, value: float) -> None:
    """A black texture has a logarithm of minus infinity, unless it is guarded."""
    network = build(name, "slim").eval()
    assert isinstance(network, StageNet)
    with torch.no_grad():
        result = network(torch.full((1, len(network.channels), 64, 64), value))
    assert torch.isfinite(result).all() and result.abs().max() <= 1.0 + 1e-6


@pytest.mark.parametrize("name", ["rho", "sigma"])
def test_normals_are_unit_and_face_outwards(name: str) -> None:
    """Whatever comes in."""
    network = stage(name).float()
    with torch.no_grad():
        normal = network(maps(network, 64, 96).float() * 50.0)
    assert torch.allclose(normal.square().sum(1), torch.ones(1, 64, 96), atol=1e-5)
    assert normal[:, 2].min() > 0.2


def test_context_knows_no_exposure_where_eyes_tell_the_light() -> None:
    """Half the light in texture and eyes is half the light found; without eyes the exposure is what tells it."""
    torch.manual_seed(3)
    network = build("delta_context", "slim").eval()
    nn.init.normal_(network.head.weight, std=0.3)
    x = torch.rand(1, len(CONTEXT_CHANNELS), 64, 96) * 2 - 1
    x[:, :3] = x[:, :3] * 0.3 + 0.1
    x[:, -1] = (x[:, -1] > 0).float()
    x[:, 3:7] = torch.tensor([-0.7, -0.9, -1.1, 1.0]).view(1, 4, 1, 1)
    dim = x.clone()
    dim[:, :3] = srgb(linear(x[:, :3] * 0.5 + 0.5) * 0.5) * 2 - 1
    dim[:, 3:6] -= math.log(2.0)
    with torch.no_grad():
        assert (network(x) - network(dim) - math.log(2.0)).abs().max() < 1e-3
        x[:, 3:7] = dim[:, 3:7] = 0.0
        assert (network(x) - network(dim) - math.log(2.0)).abs().max() > 1e-2


def test_context_does_not_look_at_hair() -> None:
    """Whatever lies where no lit skin is seen: a fringe or a collar would else be taken for shade or for a lamp."""
    torch.manual_seed(4)
    network = build("delta_context", "slim").eval()
    nn.init.normal_(network.head.weight, std=0.3)
    x = torch.rand(1, len(CONTEXT_CHANNELS), 64, 96) * 2 - 1
    x[:, -1] = (x[:, 4] > 0).float()
    hidden = (x[:, -1:] == 0).expand(-1, 3, -1, -1)
    with torch.no_grad():
        found = network(x)
        for colour in (-1.0, 0.2, 1.0):
            other = x.clone()
            other[:, :3][hidden] = colour
            assert torch.equal(network(other), found)
        x[:, :3][~hidden] = 0.2
        assert not torch.equal(network(x), found), "it does look at skin"


def test_filling_goes_on_from_lit_skin() -> None:
    """One colour stays that colour all over; nothing is brighter or darker than what is lit; lit skin stays."""
    generator = torch.Generator().manual_seed(5)
    lit = torch.zeros(2, 1, 64, 96)
    lit[:, :, 20:40, 30:70] = torch.rand(2, 1, 20, 40, generator=generator).round()
    lit[1, :, 20:40, 50:] = 0.0
    flat = torch.where(lit > 0, -2.0, 9.0)
    assert (filled(flat, lit) + 2.0).abs().max() < 1e-3
    values = torch.rand(2, 3, 64, 96, generator=generator)
    result = filled(values, lit)
    where = (lit > 0).expand_as(values)
    assert torch.equal(result[where], values[where])
    for one, seen, chosen in zip(result, values, where, strict=True):
        assert seen[chosen].min() - 1e-3 <= one.min() and one.max() <= seen[chosen].max() + 1e-3
    slope = torch.linspace(0.0, 1.0, 96).expand(2, 1, 64, 96)
    left, right = filled(slope, lit)[0, 0, :, 5].mean(), filled(slope, lit)[0, 0, :, 90].mean()
    assert left < 0.48 < 0.55 < right, "each side goes on from the skin that is nearer"
    assert not filled(values, torch.zeros_like(lit)).any(), "no skin at all: nothing is divided by its area"


@pytest.mark.parametrize("value", [-1.0, 1.0])
def test_context_is_finite_for_black_and_white_and_no_mask(value: float) -> None:
    """The mean over an empty mask, and the logarithm of black, would not be."""
    network = build("delta_context", "slim").eval()
    with torch.no_grad():
        assert network(torch.full((1, len(CONTEXT_CHANNELS), 32, 48), value)).isfinite().all()
        assert network(torch.zeros(1, len(CONTEXT_CHANNELS), 32, 48)).isfinite().all()
