"""Sending to real servers that answer, fail, hang and lead astray; the dispatcher over a real outbox."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
import shutil
import ssl
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from app.services.clock import utc_now
from app.services.errors import StorageError
from app.services.records import JobKind
from app.services.webhook_outbox import OutboxService, RetryPolicy
from app.services.webhook_records import Attempt, Delivery, DeliveryState, Webhook, WebhookEvent
from app.services.webhooks import WebhookService
from app.telemetry import Metrics
from app.workers import webhook_dispatcher as module
from app.workers.webhook_dispatcher import INTERNAL_ERROR, WebhookDispatcher
from app.workers.webhook_sender import WebhookSender, look_up, signature
from tests.support.builders import START, World, queued_job
from tests.support.receiver import DROP, HANG, Receiver
from tests.workers.polling import eventually

BODY = '{"id":"evt_1","type":"test","data":{"name":"Türe"}}'
SECRET = "whsec_test"


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with Receiver() as made:
        yield made


def webhook(url: str) -> Webhook:
    return Webhook("whk_1", url, frozenset({WebhookEvent.TEST}), None, None, True, SECRET, START, START)


def delivery() -> Delivery:
    return Delivery(
        id="whd_1",
        webhook_id="whk_1",
        event_id="evt_1",
        event=WebhookEvent.TEST,
        body=BODY,
        state=DeliveryState.PENDING,
        attempts=0,
        next_attempt_at=START,
        last_attempt_at=None,
        last_status=None,
        last_error=None,
        created_at=START,
    )


def send(url: str, *, times: int = 1, private: bool = True, timeout_s: float = 20.0, **options: object) -> Attempt:
    async def run() -> Attempt:
        sender = WebhookSender(private_networks=private, timeout_s=timeout_s, **options)  # type: ignore[arg-type]
        async with sender:
            for _ in range(times):
                attempt = await sender.send(webhook(url), delivery())
        return attempt

    return asyncio.run(run())


def to(*addresses: str) -> object:
    async def resolve(host: str, port: int) -> Sequence[str]:
        return addresses

    return resolve


def test_a_message_arrives_whole_and_signed(receiver: Receiver) -> None:
    attempt = send(receiver.url, clock=lambda: 1_790_000_000.7)
    assert attempt == Attempt(204)
    assert attempt.succeeded
    (got,) = receiver.got
    mac = hmac.new(SECRET.encode(), b"1790000000." + got.body, hashlib.sha256).hexdigest()
    assert got.body == BODY.encode()
    assert got.path == "/hook?x=1"
    assert got.headers["Isodyn-Signature"] == f"t=1790000000,v1={mac}"
    assert (got.headers["Isodyn-Event-Id"], got.headers["Isodyn-Event"]) == ("evt_1", "test")
    assert got.headers["Host"] == f"127.0.0.1:{receiver.port}"
    assert got.headers["Content-Type"] == "application/json"


def test_the_signature_is_what_other_tools_compute() -> None:
    """The value is of ``printf '1790000000.{"a":1}' | openssl dgst -sha256 -hmac key``."""
    expected = "7a4d26944722100249410c8c7f2e76c3cc6e9735fcc98b39e44a122da5490ffc"
    assert signature("key", 1790000000, b'{"a":1}') == f"t=1790000000,v1={expected}"
    assert expected not in signature("key", 1790000001, b'{"a":1}')


@pytest.mark.parametrize("status", [200, 201, 204, 299])
def test_every_2xx_is_success(receiver: Receiver, status: int) -> None:
    receiver.plan = [status]
    assert send(receiver.url).succeeded


@pytest.mark.parametrize("status", [400, 404, 410, 429, 500, 503])
def test_every_other_answer_is_failure(receiver: Receiver, status: int) -> None:
    receiver.plan = [status]
    assert send(receiver.url) == Attempt(status, f"answered {status}")


def test_redirects_are_not_followed(receiver: Receiver) -> None:
    receiver.plan = [f"http://127.0.0.1:{receiver.port}/secret"]
    attempt = send(receiver.url)
    assert (attempt.status, attempt.succeeded) == (307, False)
    assert "not followed" in (attempt.error or "")
    assert [got.path for got in receiver.got] == ["/hook?x=1"]


def test_a_server_that_hangs_is_left_after_the_time_limit(receiver: Receiver) -> None:
    receiver.plan = [HANG]
    attempt = send(receiver.url, timeout_s=0.2)
    assert attempt == Attempt(None, "no answer within 0.2 s")


def test_a_server_that_trickles_is_left_too() -> None:
    """Each piece comes well within the limit, all of it never would."""

    async def run() -> Attempt:
        over = asyncio.Event()

        async def trickle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(b"HTTP/1.1 200 OK\r\n")
            while not over.is_set():
                writer.write(b"X-More: 1\r\n")
                with suppress(TimeoutError):
                    await asyncio.wait_for(over.wait(), 0.01)
            writer.close()

        async with await asyncio.start_server(trickle, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            async with WebhookSender(private_networks=True, timeout_s=0.3) as sender:
                attempt = await sender.send(webhook(f"http://127.0.0.1:{port}/"), delivery())
            over.set()
            return attempt

    assert asyncio.run(run()).error == "no answer within 0.3 s"


def test_hanging_up_and_silence_are_failures(receiver: Receiver) -> None:
    receiver.plan = [DROP]
    dropped = send(receiver.url)
    assert dropped.status is None
    assert "RemoteProtocolError" in (dropped.error or "")
    with Receiver() as gone:
        url = gone.url
    assert "ConnectError" in (send(url).error or "")


def test_https_demands_a_certificate(receiver: Receiver) -> None:
    attempt = send(receiver.url.replace("http:", "https:"))
    assert attempt.status is None
    assert "SSL" in (attempt.error or "")


@pytest.mark.parametrize("address", ["127.0.0.1", "10.0.0.1", "169.254.169.254", "::1", "fe80::1%eth0"])
def test_names_that_lead_inside_are_refused_when_sending(receiver: Receiver, address: str) -> None:
    for addresses in ((address,), ("8.8.8.8", address)):
        attempt = send(f"https://rebound.example:{receiver.port}/", private=False, resolve=to(*addresses))
        assert attempt.status is None
        assert "inside the service's own network" in (attempt.error or "")
    assert receiver.got == []


@pytest.mark.parametrize("host", ["localhost", "127.1", "2130706433", "0x7f.0.0.1", "[::1]", "[::ffff:127.0.0.1]"])
def test_all_ways_to_write_this_machine_are_refused(receiver: Receiver, host: str) -> None:
    """Looked up by the system, as they would be."""
    attempt = send(f"https://{host}:{receiver.port}/", private=False)
    assert (attempt.status, attempt.succeeded) == (None, False)
    assert "inside" in (attempt.error or "") or "gaierror" in (attempt.error or "")


def test_plain_http_is_refused_when_sending() -> None:
    assert "https" in (send("http://8.8.8.8/", private=False).error or "")


def test_the_connection_goes_to_the_address_that_was_checked(receiver: Receiver) -> None:
    assert send(f"http://named.example:{receiver.port}/hook", resolve=to("127.0.0.1")).succeeded
    (got,) = receiver.got
    assert got.headers["Host"] == f"named.example:{receiver.port}"


def test_the_certificate_asked_for_is_that_of_the_name() -> None:
    seen: list[httpx.Request] = []

    def answer(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return httpx.Response(204)

    transport = httpx.MockTransport(answer)
    assert send("https://bücher.example/x", private=False, resolve=to("8.8.8.8"), transport=transport).succeeded
    (request,) = seen
    assert request.url == "https://8.8.8.8/x"
    assert request.headers["Host"] == "xn--bcher-kva.example"
    assert request.extensions["sni_hostname"] == "xn--bcher-kva.example"


@pytest.fixture
def certified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Receiver]:
    """A server with a certificate of ``hooks.example`` that the sender has reason to trust."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    name = ("-subj", "/CN=hooks.example", "-addext", "subjectAltName=DNS:hooks.example")
    request = ("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2", *name)
    subprocess.run([openssl, *request, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    with Receiver(tls=context) as made:
        yield made


def test_a_certificate_counts_for_its_name_alone(certified: Receiver) -> None:
    """The connection goes to an address; whose certificate that must show is still the name's affair."""
    assert send(f"https://hooks.example:{certified.port}/hook", resolve=to("127.0.0.1")).succeeded
    for host in ("other.example", "127.0.0.1"):
        attempt = send(f"https://{host}:{certified.port}/hook", resolve=to("127.0.0.1"))
        assert attempt.status is None
        assert "certificate verify failed" in (attempt.error or "")
    assert len(certified.got) == 1


def test_another_address_is_tried_when_one_does_not_listen(receiver: Receiver) -> None:
    attempt = send(f"http://named.example:{receiver.port}/hook", resolve=to("127.0.0.2", "127.0.0.1"))
    assert attempt.succeeded


def test_a_name_without_address_is_a_failure() -> None:
    async def unknown(host: str, port: int) -> Sequence[str]:
        raise OSError("no such name")

    assert send("https://nowhere.example/", resolve=unknown).error == "OSError: no such name"
    assert send("https://nowhere.example/", resolve=to()).error == "RefusedError: nowhere.example has no address"
    assert asyncio.run(look_up("127.0.0.1", 80)) == ["127.0.0.1"]


def test_a_sender_is_a_context() -> None:
    sender = WebhookSender(private_networks=True, timeout_s=5.0)
    with pytest.raises(RuntimeError, match="async with"):
        asyncio.run(sender.send(webhook("http://127.0.0.1:9/"), delivery()))


# The dispatcher


class Bench:
    """A dispatcher over a real outbox whose pauses are short."""

    def __init__(self, folder: Path, *, give_up_s: float = 3600.0, timeout_s: float = 20.0) -> None:
        self.world = World.at(folder)
        policy = RetryPolicy(first_s=0.02, longest_s=0.05, give_up_s=give_up_s)
        self.outbox = OutboxService(uow=self.world.database, clock=utc_now, policy=policy)
        self.webhooks = WebhookService(uow=self.world.database, clock=utc_now, private_networks=True)
        self.metrics = Metrics()
        self.timeout_s = timeout_s
        self.dispatcher = self.new_dispatcher()

    def new_dispatcher(self) -> WebhookDispatcher:
        def sender() -> WebhookSender:
            return WebhookSender(private_networks=True, timeout_s=self.timeout_s)

        return WebhookDispatcher(self.outbox, sender, self.metrics)

    def hook(self, url: str) -> Webhook:
        return self.webhooks.create(url, [WebhookEvent.SESSION_CLOSED])

    def test(self, hook: Webhook, n: int = 1) -> list[Delivery]:
        made = [self.webhooks.test(hook.id) for _ in range(n)]
        self.dispatcher.wake()
        return made

    def states(self, hook: Webhook) -> list[DeliveryState]:
        return [one.state for one in reversed(self.webhooks.deliveries(hook.id).items)]

    def settled(self, hook: Webhook) -> bool:
        return DeliveryState.PENDING not in self.states(hook)

    def value(self, name: str, **labels: str) -> float:
        return self.metrics.registry.get_sample_value(name, labels) or 0.0


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.02)
    monkeypatch.setattr(module, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(module, "ERROR_PAUSE_S", 0.02)


@contextmanager
def running(folder: Path, **options: float) -> Iterator[Bench]:
    bench = Bench(folder, **options)  # type: ignore[arg-type]
    bench.dispatcher.start()
    yield bench
    assert bench.dispatcher.stop(10.0)
    bench.world.close()


def ids(receiver: Receiver) -> list[str]:
    return [got.headers["Isodyn-Event-Id"] for got in receiver.got]


def test_messages_arrive_in_order_each_once(tmp_path: Path, receiver: Receiver) -> None:
    """With the pauses of a service, woken by jobs as in one."""
    with running(tmp_path) as bench:
        hook = bench.hook(receiver.url)
        made = bench.test(hook, 5)
        bench.dispatcher.job_finished(queued_job())
        eventually(lambda: bench.settled(hook))
        assert ids(receiver) == [one.event_id for one in made]
        assert [json.loads(got.body)["id"] for got in receiver.got] == ids(receiver)
        eventually(lambda: bench.value("isodyn_webhook_attempts_total", outcome="delivered") == 5)
        eventually(lambda: bench.value("isodyn_webhook_seconds_count") == 5)
        assert bench.value("isodyn_webhook_errors_total") == 0


@pytest.mark.usefixtures("quick")
def test_failures_are_tried_again_and_hold_the_order(tmp_path: Path, receiver: Receiver) -> None:
    receiver.plan = [500, DROP, 503, 204, 500]
    with running(tmp_path) as bench:
        hook = bench.hook(receiver.url)
        first, second = bench.test(hook, 2)
        eventually(lambda: bench.settled(hook))
        assert ids(receiver) == [first.event_id] * 4 + [second.event_id] * 2
        stored = {one.id: one for one in bench.webhooks.deliveries(hook.id).items}
        assert (stored[first.id].attempts, stored[second.id].attempts) == (4, 2)
        assert stored[first.id].last_error is None
        eventually(lambda: bench.value("isodyn_webhook_attempts_total", outcome="failed") == 4)


@pytest.mark.usefixtures("quick")
def test_a_webhook_that_hangs_holds_up_no_other(tmp_path: Path, receiver: Receiver) -> None:
    with Receiver(plan=[HANG] * 50) as stuck, running(tmp_path, timeout_s=0.5) as bench:
        slow, good = bench.hook(stuck.url), bench.hook(receiver.url)
        bench.test(slow)
        eventually(lambda: stuck.got)
        bench.test(good, 3)
        eventually(lambda: bench.settled(good))
        assert bench.states(slow) == [DeliveryState.PENDING]
        eventually(lambda: bench.webhooks.deliveries(slow.id).items[0].last_error == "no answer within 0.5 s")


@pytest.mark.usefixtures("quick")
def test_what_cannot_be_delivered_dies_and_can_be_sent_again(tmp_path: Path, receiver: Receiver) -> None:
    receiver.plan = [500]
    with running(tmp_path, give_up_s=0.0) as bench:
        hook = bench.hook(receiver.url)
        (made,) = bench.test(hook)
        eventually(lambda: bench.states(hook) == [DeliveryState.DEAD])
        eventually(lambda: bench.value("isodyn_webhook_attempts_total", outcome="dead") == 1)
        bench.webhooks.redeliver(hook.id, made.id)
        bench.dispatcher.wake()
        eventually(lambda: bench.states(hook) == [DeliveryState.DEAD, DeliveryState.DELIVERED])
        assert ids(receiver) == [made.event_id] * 2


@pytest.mark.usefixtures("quick")
def test_a_stop_waits_for_no_hanging_server_and_the_next_start_sends_again(tmp_path: Path, receiver: Receiver) -> None:
    receiver.plan = [HANG]
    with running(tmp_path) as bench:
        hook = bench.hook(receiver.url)
        (made,) = bench.test(hook)
        eventually(lambda: receiver.got)
        assert bench.dispatcher.stop(0.1)
        bench.dispatcher.wake()
        bench.dispatcher.job_finished(queued_job())
        assert bench.states(hook) == [DeliveryState.PENDING]
        bench.dispatcher = bench.new_dispatcher()
        bench.dispatcher.start()
        eventually(lambda: bench.settled(hook))
        assert ids(receiver) == [made.event_id] * 2


@pytest.mark.usefixtures("quick")
def test_a_database_in_trouble_ends_nothing(
    tmp_path: Path, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither while looking nor while storing what came of a message, which is then sent once more."""
    with running(tmp_path) as bench:
        hook = bench.hook(receiver.url)
        troubles = {"due": 2, "settle": 1}

        def failing(name: str) -> None:
            real = getattr(bench.outbox, name)

            def call(*args: object, **kwargs: object) -> object:
                if troubles[name]:
                    troubles[name] -= 1
                    raise StorageError if name == "due" else ZeroDivisionError
                return real(*args, **kwargs)

            monkeypatch.setattr(bench.outbox, name, call)

        failing("due")
        failing("settle")
        bench.test(hook)
        eventually(lambda: bench.settled(hook))
        assert len(receiver.got) == 2
        eventually(lambda: bench.value("isodyn_webhook_errors_total") == 3)


@pytest.mark.usefixtures("quick")
def test_an_error_of_the_sender_is_a_failed_attempt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(*_: object) -> int:
        raise ZeroDivisionError

    monkeypatch.setattr(WebhookSender, "_post", broken)
    with running(tmp_path, give_up_s=0.0) as bench:
        hook = bench.hook("http://127.0.0.1:9/")
        bench.test(hook)
        eventually(lambda: bench.settled(hook))
        (one,) = bench.webhooks.deliveries(hook.id).items
        assert (one.state, one.last_error) == (DeliveryState.DEAD, INTERNAL_ERROR)


def test_a_dispatcher_that_never_started_stops(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.dispatcher.wake()
    bench.dispatcher.job_queued(queued_job())
    bench.dispatcher.job_finished(replace(queued_job(), kind=JobKind.CONTRIBUTE))
    assert bench.dispatcher.stop(0.0)
    bench.world.close()
