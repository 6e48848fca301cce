"""A server with the chat API of OpenAI whose answers follow a script: it has no model, and ignores what a request asks.

    python3 configs/language-models/scripted_server.py

It waits as long as a model would compute, and then sends words at a fixed pace. Each word is a token. The number of
words is drawn from a mixture of normal distributions. So the correct result of a measurement is known in advance.

With a picture and the default options, it is ten times as fast as the language model on the robot of the paper: 80 to
145 tokens/s and 0.5 to 2 s per answer, instead of 8 to 15 tokens/s and 5 to 20 s. As in the paper, answers have two
common lengths.

Needs Python 3.9 or later, and no packages. Ctrl-C stops it.
"""

import argparse
import asyncio
import contextlib
import itertools
import json
import math
import random
import selectors
import signal
import time
from dataclasses import dataclass

MODEL = "scripted"
TEXT = "This answer follows a script; no model has read the question."
# Input tokens of a picture in LLaVA-1.5: 24 × 24 patches.
PICTURE_TOKENS = 576
MAX_BODY_BYTES = 64 << 20
MAX_HEADER_BYTES = 64 << 10


class RequestError(Exception):
    """A request that is answered with an HTTP status other than 200."""

    def __init__(self, status, text):
        super().__init__(text)
        self.status = status


@dataclass(frozen=True)
class Mode:
    """One of the common lengths of answers: a normal distribution, in tokens, and its weight in the mixture."""

    mean: float
    deviation: float
    weight: float


def parse_lengths(text):
    """Reads `MEAN:DEVIATION:WEIGHT,…`. Raises `ArgumentTypeError` if a number is missing or not allowed."""
    modes = []
    for part in text.split(","):
        try:
            mode = Mode(*map(float, part.split(":")))
        except (TypeError, ValueError):
            raise argparse.ArgumentTypeError(f"{part!r} is not MEAN:DEVIATION:WEIGHT, such as 60:12:0.5") from None
        is_finite = all(map(math.isfinite, (mode.mean, mode.deviation, mode.weight)))
        if not (is_finite and mode.mean >= 1 and mode.deviation >= 0 and mode.weight > 0):
            rule = "the mean must be at least 1, the deviation at least 0, the weight above 0, all finite"
            raise argparse.ArgumentTypeError(f"{part!r}: {rule}")
        modes.append(mode)
    return modes


def parse_milliseconds(text):
    """Reads a duration in milliseconds; returns seconds."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of milliseconds of at least 0")
    return value / 1000


class Script:
    """Times (seconds) and lengths of the answers. The same seed gives the same sequence of lengths."""

    def __init__(self, seed, prefill, picture, token, lengths):
        self.random = random.Random(seed)
        self.prefill, self.picture, self.token, self.lengths = prefill, picture, token, lengths

    def draw_length(self):
        """Returns the number of tokens of the next answer."""
        [mode] = self.random.choices(self.lengths, [mode.weight for mode in self.lengths])
        return max(1, round(self.random.gauss(mode.mean, mode.deviation)))

    def time_to_first_token(self, pictures):
        """Returns the time from the request to the first token, in seconds."""
        return self.prefill + self.picture * pictures


def read_question(request):
    """Returns the number of characters and of pictures in the messages of a request."""
    characters, pictures = 0, 0
    messages = request.get("messages")
    if not isinstance(messages, list) or not all(isinstance(message, dict) for message in messages):
        raise RequestError("400 Bad Request", "messages is not a list of objects")
    for message in messages:
        content = message.get("content")
        items = [{"type": "text", "text": content}] if isinstance(content, str) else content
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise RequestError("400 Bad Request", "the content of a message is not a text or a list of objects")
        for item in items:
            if item.get("type") == "image_url":
                pictures += 1
            else:
                characters += len(str(item.get("text", "")))
    return characters, pictures


def is_positive_integer(value):
    return isinstance(value, int) and not isinstance(value, bool) and value > 0


class Answer:
    """Answer to a request: its tokens, the time at which each is sent, and the JSON around them."""

    def __init__(self, script, request, number):
        characters, pictures = read_question(request)
        self.id = f"chatcmpl-{number}"
        self.script, self.time_to_first_token = script, script.time_to_first_token(pictures)
        self.drawn = script.draw_length()
        # `max_completion_tokens` is the newer name of the field `max_tokens`.
        limits = [request.get(name) for name in ("max_completion_tokens", "max_tokens")]
        self.length = min([self.drawn, *filter(is_positive_integer, limits)])
        self.finish_reason = "length" if self.length < self.drawn else "stop"
        self.is_streamed = request.get("stream") is True
        options = request.get("stream_options")
        self.includes_usage = isinstance(options, dict) and bool(options.get("include_usage"))
        # A token of English text has about four characters.
        input_tokens = max(1, characters // 4) + PICTURE_TOKENS * pictures
        self.usage = {
            "prompt_tokens": input_tokens,
            "completion_tokens": self.length,
            "total_tokens": input_tokens + self.length,
            "prompt_tokens_details": {"cached_tokens": 0},
        }

    def tokens(self):
        """Yields each token with its time after the request, in seconds."""
        words = itertools.cycle(TEXT.split())
        for number, word in enumerate(itertools.islice(words, self.length)):
            yield self.time_to_first_token + number * self.script.token, word if number == 0 else f" {word}"

    def object(self, kind, **fields):
        return {"id": self.id, "object": kind, "created": int(time.time()), "model": MODEL, **fields}

    def chunk(self, delta, finish_reason=None):
        choice = {"index": 0, "delta": delta, "finish_reason": finish_reason}
        return self.object("chat.completion.chunk", choices=[choice])


class Server:
    """Answers requests concurrently, one on each connection."""

    def __init__(self, script):
        self.script, self.numbers, self.connections = script, itertools.count(1), set()

    async def serve(self, reader, writer):
        """Answers the request of a connection, and stops as soon as the client closes the connection."""
        connection = asyncio.current_task()
        self.connections.add(connection)
        connection.add_done_callback(self.connections.discard)
        try:
            await self.respond_until_disconnect(writer, reader, *await read_request(reader))
        except RequestError as error:
            with contextlib.suppress(ConnectionError):
                details = {"message": str(error), "type": "invalid_request_error"}
                await send_json(writer, error.status, {"error": details})
        except (ConnectionError, asyncio.IncompleteReadError, asyncio.CancelledError):
            # The client has disconnected or the server is stopping, so no answer is needed.
            pass
        finally:
            writer.close()

    async def respond_until_disconnect(self, writer, reader, *request):
        answer = asyncio.ensure_future(self.respond(writer, *request))
        disconnect = asyncio.ensure_future(wait_for_disconnect(reader))
        try:
            await asyncio.wait({answer, disconnect}, return_when=asyncio.FIRST_COMPLETED)
            if answer.done():
                answer.result()
        finally:
            answer.cancel()
            disconnect.cancel()
            await asyncio.gather(answer, disconnect, return_exceptions=True)

    async def respond(self, writer, method, path, body):
        if (method, path) == ("GET", "/v1/models"):
            model = {"id": MODEL, "object": "model", "created": 0, "owned_by": "peernet"}
            await send_json(writer, "200 OK", {"object": "list", "data": [model]})
        elif (method, path) == ("POST", "/v1/chat/completions"):
            await self.complete(writer, body)
        else:
            known = "GET /v1/models and POST /v1/chat/completions"
            raise RequestError("404 Not Found", f"this server has {known}, not {method} {path}")

    async def complete(self, writer, body):
        """Sends the tokens of an answer, each at its time, or all of them at the end if the answer is not streamed."""
        start = asyncio.get_running_loop().time()
        try:
            request = json.loads(body)
        except ValueError as error:
            raise RequestError("400 Bad Request", f"the body is not JSON: {error}") from None
        if not isinstance(request, dict):
            raise RequestError("400 Bad Request", "the body is not an object")
        answer = Answer(self.script, request, next(self.numbers))
        sent = 0
        try:
            if answer.is_streamed:
                await send_head(writer, "200 OK", "text/event-stream", "Transfer-Encoding: chunked")
                for at, token in answer.tokens():
                    await sleep_until(start + at)
                    if sent == 0:
                        await send_event(writer, answer.chunk({"role": "assistant", "content": ""}))
                    await send_event(writer, answer.chunk({"content": token}))
                    sent += 1
                await send_event(writer, answer.chunk({}, answer.finish_reason))
                if answer.includes_usage:
                    await send_event(writer, answer.object("chat.completion.chunk", choices=[], usage=answer.usage))
                await send_http_chunk(writer, b"data: [DONE]\n\n")
                await send_http_chunk(writer, b"")
            else:
                text = "".join(token for _, token in answer.tokens())
                await sleep_until(start + answer.time_to_first_token + (answer.length - 1) * self.script.token)
                message = {"role": "assistant", "content": text}
                choice = {"index": 0, "message": message, "finish_reason": answer.finish_reason}
                completion = answer.object("chat.completion", choices=[choice], usage=answer.usage)
                await send_json(writer, "200 OK", completion)
        except (ConnectionError, asyncio.CancelledError):
            # The client has disconnected, or the server is stopping.
            print(f"{answer.id}: stopped after {sent} of {answer.length} tokens", flush=True)
            raise


async def sleep_until(at):
    """Sleeps until a time of the event loop's clock. With relative sleeps, the delays of the tokens would add up."""
    await asyncio.sleep(at - asyncio.get_running_loop().time())


async def wait_for_disconnect(reader):
    while await reader.read(4096):
        pass


async def read_request(reader):
    """Returns method, path and body of a request."""
    try:
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        method, path, _ = head[0].split(" ")
        headers = dict(line.lower().split(":", 1) for line in head[1:] if line)
        length = int(headers.get("content-length", "0"))
    except (ValueError, asyncio.LimitOverrunError):
        raise RequestError("400 Bad Request", "this is not an HTTP request with a Content-Length") from None
    if not 0 <= length <= MAX_BODY_BYTES:
        raise RequestError("413 Content Too Large", f"the body has more than {MAX_BODY_BYTES} bytes")
    return method, path.partition("?")[0], await reader.readexactly(length)


async def send(writer, data):
    writer.write(data)
    await writer.drain()


async def send_head(writer, status, content_type, *headers):
    lines = [f"HTTP/1.1 {status}", f"Content-Type: {content_type}", *headers, "Connection: close", "", ""]
    await send(writer, "\r\n".join(lines).encode())


async def send_json(writer, status, value):
    body = json.dumps(value).encode()
    await send_head(writer, status, "application/json", f"Content-Length: {len(body)}")
    await send(writer, body)


async def send_http_chunk(writer, data):
    await send(writer, b"%x\r\n%s\r\n" % (len(data), data))


async def send_event(writer, value):
    await send_http_chunk(writer, b"data: %s\n\n" % json.dumps(value).encode())


async def run(arguments):
    script = Script(arguments.seed, arguments.prefill_ms, arguments.picture_ms, arguments.token_ms, arguments.lengths)
    server = Server(script)
    listener = await asyncio.start_server(server.serve, arguments.host, arguments.port, limit=MAX_HEADER_BYTES)
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    host, port = listener.sockets[0].getsockname()[:2]
    print(f"scripted answers, no model: http://{f'[{host}]' if ':' in host else host}:{port}/v1", flush=True)
    await stop.wait()
    listener.close()
    for task in server.connections:
        task.cancel()
    await asyncio.gather(*server.connections, return_exceptions=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    option = parser.add_argument
    option("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    option("--port", type=int, default=8080, help="port to listen on; 0: any free port (default: %(default)s)")
    option("--seed", type=int, default=1, help="seed of the lengths (default: %(default)s)")
    for name, default, meaning in [
        ("--prefill-ms", "20", "time from the request to the first token, without pictures"),
        ("--picture-ms", "250", "additional time to the first token for each picture"),
        ("--token-ms", "6", "time from one token to the next"),
    ]:
        help_text = f"{meaning} (default: %(default)s)"
        option(name, type=parse_milliseconds, default=default, metavar="MS", help=help_text)
    option(
        "--lengths",
        type=parse_lengths,
        default="60:12:0.5,240:25:0.5",
        metavar="MEAN:DEVIATION:WEIGHT,…",
        help="common lengths of answers, in tokens (default: %(default)s); 3:1:0.2,60:12:0.4,240:25:0.4 adds the "
        "length of the answers yes and no",
    )
    arguments = parser.parse_args()
    # Sleeps with `epoll` are rounded up to milliseconds, those with `select` are not.
    loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
    try:
        loop.run_until_complete(run(arguments))
    except OSError as error:
        parser.exit(69, f"cannot listen on {arguments.host}:{arguments.port}: {error}\n")
    finally:
        loop.close()


if __name__ == "__main__":
    main()
