"""Image, compose files, Kubernetes: what goes in, what it may do, and that names are those of the code."""

from __future__ import annotations

import fnmatch
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

import pytest
import sqlalchemy as sa
import yaml  # type: ignore[import-untyped]

from service import __version__
from service.api.front import Hosts
from service.batch.shards import Rounds
from service.jobs.admission import NewJob
from service.jobs.database import connect, create_tables
from service.jobs.settings import PREFIX, Settings
from service.jobs.store import Store

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"


def script(name: str) -> ModuleType:
    specification = importlib.util.spec_from_file_location(name, DEPLOY / f"{name}.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def document(name: str) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((ROOT / name).read_text("utf-8"))
    return content


def instructions() -> list[tuple[str, str]]:
    """(instruction, arguments) of the Dockerfile, with continued lines joined."""
    text = re.sub(r"\\\n", " ", re.sub(r"^\s*#.*\n", "", (ROOT / "Dockerfile").read_text("utf-8"), flags=re.MULTILINE))
    return [(line.split(None, 1)[0], " ".join(line.split(None, 1)[1].split())) for line in text.splitlines() if line]


def values(instruction: str) -> list[str]:
    return [arguments for name, arguments in instructions() if name == instruction]


# --- what goes into the build


def sent(path: str) -> bool:
    """Whether .dockerignore lets a file in: the last pattern that matches it, or a folder above it, decides."""
    lines = [line.strip() for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines()]
    ignored = False
    for line in (line for line in lines if line and not line.startswith("#")):
        pattern = line.removeprefix("!").strip("/")
        heads = [str(head) for head in [PurePosixPath(path), *PurePosixPath(path).parents] if str(head) != "."]
        if any(_matches(head, pattern) for head in heads):
            ignored = not line.startswith("!")
    return not ignored


def _matches(path: str, pattern: str) -> bool:
    """Patterns of Go's filepath.Match, with ** for any number of folders."""
    parts, wanted = path.split("/"), pattern.split("/")
    if wanted[0] == "**":
        return any(_matches("/".join(parts[start:]), "/".join(wanted[1:])) for start in range(len(parts)))
    return len(parts) == len(wanted) and all(map(fnmatch.fnmatchcase, parts, wanted))


def tracked() -> list[str]:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in listing.split("\0") if name and (ROOT / name).exists()]


def copied() -> list[str]:
    """Sources of every COPY from the context."""
    return [source for line in values("COPY") if not line.startswith("--from") for source in line.split()[:-1]]


def test_all_that_serving_needs_is_sent_and_copied() -> None:
    needed = [name for name in tracked() if name.startswith("service/")]
    assert any(name.endswith(".onnx") for name in needed)
    assert not [name for name in needed if not sent(name)]
    assert "service" in copied()
    for source in copied():
        assert (ROOT / source).exists(), f"COPY {source}: there is no such file"
        below = [source] if (ROOT / source).is_file() else [name for name in tracked() if name.startswith(f"{source}/")]
        assert below and all(sent(name) for name in below), f"COPY {source}: .dockerignore keeps it out"


def test_every_data_file_is_part_of_the_package() -> None:
    """A checkout has them all; the image has what the package data of pyproject.toml names."""
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["package-data"][
        "service"
    ]
    packed = {path for pattern in patterns for path in (ROOT / "service").glob(pattern)}
    data = {ROOT / name for name in tracked() if name.startswith("service/") and not name.endswith(".py")}
    assert data and not data - packed


def test_nothing_else_is_sent() -> None:
    """Deny by default: a photo, a key or a dump that lies in the folder must not end in an image."""
    allowed = {"service", "LICENSES", "deploy"}
    outside = [name for name in tracked() if PurePosixPath(name).parts[0] not in allowed and sent(name)]
    assert set(outside) == {"pyproject.toml", "README.md", "LICENSE", "NOTICE", "THIRD_PARTY.md"}
    for name in (
        ".git/config",
        ".env",
        "me.jpg",
        "out/me.zip",
        "service/.env",
        "service/data/.DS_Store",
        "service/cli/__pycache__/app.cpython-311.pyc",
        "deploy/secret.yaml",
        "models/head/build.py",
        "tests/conftest.py",
        "avatarme-data/jobs.sqlite",
        ".venv/bin/python",
    ):
        assert not sent(name), name


# --- the image


def test_the_image_runs_as_nobody_in_particular() -> None:
    assert values("USER") == ["10001:10001"], "numeric: Kubernetes cannot check a name"
    assert values("VOLUME") == ["/data"]
    assert json.loads(values("ENTRYPOINT")[0])[:2] == ["tini", "--"]
    assert json.loads(values("CMD")[0]) == ["serve"]
    assert "CMD [" in values("HEALTHCHECK")[0], "without a shell"


def test_every_file_that_is_installed_has_its_hash() -> None:
    (build, *_) = (line for line in values("RUN") if "pip" in line)
    installs = [part for part in build.split("&&") if " install " in part]
    assert len(installs) == 2 and all("--require-hashes" in part for part in installs)
    later = " ".join(line for line in values("RUN") if line != build)
    assert all("--no-index" in part for part in later.split("&&") if "pip" in part and " install " in part)
    assert "--no-build-isolation" in later, "else setuptools would come from anywhere, in any version"
    for lock in sorted((DEPLOY / "locks").glob("*.txt")):
        for name, block in script("requirements").blocks(lock.read_text("ascii")).items():
            assert re.match(rf"{re.escape(name)}==\S+", block), (lock.name, name)
            assert "--hash=sha256:" in block, (lock.name, name)


def test_the_bill_of_materials_names_packages_and_data_files() -> None:
    bill = script("sbom").bill()
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    components = {entry["name"]: entry for entry in bill["components"]}
    assert components["numpy"]["purl"].startswith("pkg:pypi/numpy@")
    networks = [entry for entry in bill["components"] if entry["type"] == "machine-learning-model"]
    assert networks and all(len(entry["hashes"][0]["content"]) == 64 for entry in networks)
    references = [entry["bom-ref"] for entry in bill["components"]]
    assert len(references) == len(set(references))


def test_nothing_in_the_image_can_install() -> None:
    """The base brings pip into the last stage too, although the program has an environment without it."""
    last = values("RUN")[-1]
    removed = re.search(r"python -m pip uninstall --yes \S+ ([a-z ]+?) &&", last)
    assert removed is not None and {"pip", "setuptools", "wheel"} <= set(removed[1].split())
    assert "rm -r /usr/local/lib/python3*/ensurepip" in last, "wheels of pip lie there"
    assert "pip" not in values("COPY")[-1] and values("COPY")[-1].startswith("--from=build")


def test_the_version_is_that_of_the_program() -> None:
    assert f"VERSION={__version__}" in values("ARG")
    texts = [path.read_text("utf-8") for path in (ROOT / "compose.yaml", *DEPLOY.glob("*.yaml"))]
    images = {image for text in texts for image in re.findall(r"image: (avatarme:\S+)", text)}
    assert images == {f"avatarme:{__version__}"}


def test_no_torch_and_no_development_tool() -> None:
    """All that pyproject.toml asks for is there, and nothing of training, conversion and tests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    printed = script("requirements").requirements([])
    names = set(re.findall(r"^([A-Za-z0-9._-]+)==", printed, re.MULTILINE))
    wanted = {re.split(r"[\[<>=; ]", line)[0] for line in project["dependencies"]}
    assert wanted <= names
    assert not {"torch", "pytest", "mitsuba", "onnx", "ruff", "mypy"} & names
    with pytest.raises(FileNotFoundError):
        script("requirements").requirements(["no-such-extra"])


# --- names of settings


def test_every_variable_is_a_setting() -> None:
    """A misspelt variable would be passed over in silence."""
    known = {PREFIX + field.name.upper() for field in fields(Settings)}
    of_compose = {"AVATARME_CONTAINER_MEMORY"}  # for compose itself, not for the program
    for path in (ROOT / "Dockerfile", ROOT / "compose.yaml", *DEPLOY.glob("*.*")):
        used = set(re.findall(r"AVATARME_[A-Z_]+", path.read_text("utf-8")))
        assert used <= known | of_compose, path.name
    told = set(re.findall(r"AVATARME_[A-Z_]+", (ROOT / "docs" / "deploy.md").read_text("utf-8")))
    assert told <= known | of_compose | {"AVATARME_API_KEY", "AVATARME_SERVER"}


# --- compose


def ours(name: str) -> dict[str, dict[str, Any]]:
    services: dict[str, dict[str, Any]] = document(name)["services"]
    return {key: value for key, value in services.items() if str(value.get("image", "")).startswith("avatarme:")}


@pytest.mark.parametrize("name", ["compose.yaml", "deploy/compose.workers.yaml"])
def test_containers_may_do_nothing_that_they_need_not(name: str) -> None:
    assert ours(name)
    for service in ours(name).values():
        assert service["read_only"] is True
        assert service["cap_drop"] == ["ALL"]
        assert "no-new-privileges:true" in service["security_opt"]
        assert service["volumes"] == ["data:/data"], "one place to write to"
        assert [mount.split(":")[0].strip("/") for mount in service["tmpfs"]] == ["tmp"]
        assert not {"privileged", "user", "network_mode", "devices"} & set(service)
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))
        assert {"mem_limit", "pids_limit", "stop_grace_period", "restart"} <= set(service)


# --- Kubernetes


def objects() -> dict[tuple[str, str], dict[str, Any]]:
    items = document("deploy/kubernetes/base/service.yaml")["items"]
    return {(item["kind"], item["metadata"]["name"]): item for item in items}


def kustomized(folder: str) -> dict[str, dict[str, Any]]:
    """What kubectl makes of a folder, by kind and name."""
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed")
    said = subprocess.run(["kubectl", "kustomize", folder], cwd=ROOT, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    return {f"{item['kind']}/{item['metadata']['name']}": item for item in yaml.safe_load_all(said.stdout)}


def containers(item: dict[str, Any]) -> list[dict[str, Any]]:
    return list(item["spec"]["template"]["spec"]["containers"])


def test_workers_are_scaled_by_what_is_unfinished(tmp_path: Path) -> None:
    """The question that KEDA asks the database, asked here of our own tables."""
    made = kustomized("deploy/kubernetes/autoscaling")
    scaled = made["ScaledObject/worker"]["spec"]
    assert "replicas" not in made["StatefulSet/worker"]["spec"], "each apply would set it back"
    (worker,) = containers(made["StatefulSet/worker"])
    assert {"name": "AVATARME_BATCHES", "value": "1"} in worker["env"], "else its shards would wait for ever"
    assert scaled["scaleTargetRef"]["name"] == made["StatefulSet/worker"]["metadata"]["name"]
    (trigger,) = scaled["triggers"]
    assert trigger["authenticationRef"]["name"] == made["TriggerAuthentication/queue"]["metadata"]["name"]
    settings = Settings(data=tmp_path)
    engine = connect(settings.database_url)
    create_tables(engine, settings)
    store = Store(engine)
    more: dict[str, Any] = {"options": {}, "photo": "", "photo_sha256": "", "photo_bytes": 0, "keep_photo": False}
    for number in range(4):
        store.add(NewJob(id=f"{number:032x}", tenant="t", key=None, digest="", **more))
    store.cancel(f"{0:032x}", 0.0)
    Rounds(engine).put(store.queue, "round", "s3://bucket/out", [100, 50])
    Rounds(engine).told("round", 0, {}, ended=True)
    with engine.connect() as connection:
        assert connection.execute(sa.text(trigger["metadata"]["query"])).scalar_one() == 3 + 1


@pytest.mark.parametrize("key", [("Deployment", "api"), ("StatefulSet", "worker")])
def test_pods_may_do_nothing_that_they_need_not(key: tuple[str, str]) -> None:
    pod = objects()[key]["spec"]["template"]["spec"]
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert f"{pod['securityContext']['runAsUser']}:{pod['securityContext']['runAsGroup']}" == values("USER")[0]
    assert pod["automountServiceAccountToken"] is False
    (container,) = pod["containers"]
    rights = container["securityContext"]
    assert rights["readOnlyRootFilesystem"] and not rights["allowPrivilegeEscalation"]
    assert rights["capabilities"] == {"drop": ["ALL"]}
    assert "memory" in container["resources"]["limits"]


def test_servers_have_keys_and_memory_for_the_largest_photo() -> None:
    """In containers the server listens to everybody; without keys it would not start."""
    told = " ".join(values("ENV"))
    assert "AVATARME_HOST=0.0.0.0" in told and "AVATARME_KEYS=/data/keys.json" in told and "FIRST_KEY=true" in told
    api = document("deploy/compose.workers.yaml")["services"]["api"]
    assert api["environment"]["AVATARME_KEYS"].startswith(api["environment"]["AVATARME_DATA"])
    assert api["mem_limit"] == "2g"
    (container,) = objects()["Deployment", "api"]["spec"]["template"]["spec"]["containers"]
    assert container["resources"]["limits"]["memory"] == "2Gi"
    names = {variable["name"]: variable for variable in container["env"]}
    assert names["AVATARME_KEYS"]["value"] == "/keys/keys.json"
    assert names["PGPASSWORD"]["valueFrom"]["secretKeyRef"]["key"] == "password"


# --- healthcheck


@contextmanager
def answering(status: int, hosts: list[str]) -> Iterator[int]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            hosts.append(self.headers["Host"])
            self.send_response(status if self.path == "/readyz" else 404)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize(("status", "healthy"), [(200, True), (503, False), (400, False)])
def test_healthy_is_who_takes_photos(status: int, healthy: bool) -> None:
    with answering(status, []) as port:
        assert script("healthcheck").healthy({"AVATARME_PORT": str(port)}) is healthy


def test_a_server_with_a_list_of_names_is_asked_by_its_address() -> None:
    hosts: list[str] = []
    with answering(200, hosts) as port:
        assert script("healthcheck").healthy({"AVATARME_PORT": str(port), "AVATARME_ALLOWED_HOSTS": "a.example"})
    (host,) = hosts
    assert Hosts(Settings(allowed_hosts="a.example")).allow(host, "/readyz"), host


# --- what other people's checkers say (make deploy-check installs them)

CHECKERS = "is not installed: make deploy-check"


def checker(program: str) -> str:
    found = shutil.which(program, path=f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}")
    if found is None:
        pytest.skip(f"{program} {CHECKERS}")
    return found


def test_hadolint_has_no_remark() -> None:
    said = subprocess.run([checker("hadolint"), "Dockerfile"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (said.returncode, said.stdout) == (0, "")


@pytest.mark.parametrize("name", ["compose.yaml", "deploy/compose.workers.yaml"])
def test_compose_files_fit_the_specification(name: str) -> None:
    command = [checker("check-jsonschema"), "--builtin-schema", "vendor.compose-spec", name]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stdout


@pytest.mark.parametrize("key", sorted(objects()), ids="/".join)
def test_kubernetes_knows_every_field(key: tuple[str, str]) -> None:
    kubernetes_validate = pytest.importorskip("kubernetes_validate", reason=f"kubernetes-validate {CHECKERS}")
    newest = kubernetes_validate.latest_version()
    kubernetes_validate.validate(objects()[key], newest, strict=True)
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate({**objects()[key], "specs": {}}, newest, strict=True)


def test_the_locks_have_the_versions_that_are_tested() -> None:
    pinned = r"^([A-Za-z0-9._-]+)==([^\s;]+)"
    tested: dict[str, set[str]] = {}  # some have another version for another Python
    for name, version in re.findall(pinned, (ROOT / "requirements.lock").read_text("utf-8"), re.MULTILINE):
        tested.setdefault(name, set()).add(version)
    for lock in sorted((DEPLOY / "locks").glob("*.txt")):
        for name, version in re.findall(pinned, lock.read_text("ascii"), re.MULTILINE):
            assert version in tested.get(name, {version}), f"{lock.name}: {name}; make lock"
