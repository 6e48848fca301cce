"""A master of ROS 1 for tests, where Debian's rosmaster is not installed: topics only, as the protocol has them.

Usage: master.py PORT [stay]. Prints "ready" and its port when it answers, and ends with its standard input unless it is to
stay.
"""

import os
import queue
import socketserver
import sys
import threading
import xmlrpc.client
import xmlrpc.server


class Server(socketserver.ThreadingMixIn, xmlrpc.server.SimpleXMLRPCServer):
    daemon_threads = True
    allow_reuse_address = True


class Handler(xmlrpc.server.SimpleXMLRPCRequestHandler):
    rpc_paths = ("/", "/RPC2")


class Master:
    def __init__(self, uri):
        self.uri = uri
        self.lock = threading.Lock()
        self.publishers, self.subscribers, self.types, self.nodes = {}, {}, {}, {}

    def register(self, topics, node, topic, uri):
        older = self.nodes.get(node)
        self.nodes[node] = uri
        topics.setdefault(topic, {})[node] = uri
        if older not in (None, uri):
            reason = f"[{node}] Reason: new node registered with same name"
            tell(older, "shutdown", "/master", reason)

    def tell_subscribers(self, topic):
        publishers = list(self.publishers.get(topic, {}).values())
        for uri in self.subscribers.get(topic, {}).values():
            tell(uri, "publisherUpdate", "/master", topic, publishers)

    def registerPublisher(self, node, topic, kind, uri):
        with self.lock:
            if kind != "*" or topic not in self.types:
                self.types[topic] = kind
            self.register(self.publishers, node, topic, uri)
            self.tell_subscribers(topic)
            return 1, "", list(self.subscribers.get(topic, {}).values())

    def registerSubscriber(self, node, topic, kind, uri):
        with self.lock:
            self.types.setdefault(topic, kind)
            self.register(self.subscribers, node, topic, uri)
            return 1, "", list(self.publishers.get(topic, {}).values())

    def unregister(self, topics, node, topic, uri):
        nodes = topics.get(topic, {})
        if nodes.get(node) != uri:
            return 1, "", 0
        del nodes[node]
        if not nodes:
            del topics[topic]
        return 1, "", 1

    def unregisterPublisher(self, node, topic, uri):
        with self.lock:
            answer = self.unregister(self.publishers, node, topic, uri)
            self.tell_subscribers(topic)
            return answer

    def unregisterSubscriber(self, node, topic, uri):
        with self.lock:
            return self.unregister(self.subscribers, node, topic, uri)

    def lookupNode(self, _caller, node):
        with self.lock:
            uri = self.nodes.get(node)
            return (1, "", uri) if uri else (-1, f"unknown node [{node}]", "")

    def getSystemState(self, _caller):
        def entries(topics):
            return [[topic, list(nodes)] for topic, nodes in topics.items()]

        with self.lock:
            return 1, "", [entries(self.publishers), entries(self.subscribers), []]

    def getTopicTypes(self, _caller):
        with self.lock:
            return 1, "", [list(pair) for pair in self.types.items()]

    def getUri(self, _caller):
        return 1, "", self.uri

    def getPid(self, _caller):
        return 1, "", os.getpid()


CALLS = queue.Queue()


def tell(uri, method, *params):
    """Calls a node in the background, after the calls before."""
    CALLS.put((uri, method, params))


def call_nodes():
    while True:
        uri, method, params = CALLS.get()
        try:
            getattr(xmlrpc.client.ServerProxy(uri), method)(*params)
        except (OSError, xmlrpc.client.Error):
            pass  # The node may be gone.


def end_with_input():
    sys.stdin.read()
    os._exit(0)


def main():
    port = int(sys.argv[1])
    server = Server(("127.0.0.1", port), requestHandler=Handler, logRequests=False)
    server.register_instance(Master(f"http://127.0.0.1:{server.server_address[1]}/"))
    print(f"ready {server.server_address[1]}", flush=True)
    if "stay" not in sys.argv:
        threading.Thread(target=end_with_input, daemon=True).start()
    threading.Thread(target=call_nodes, daemon=True).start()
    server.serve_forever()


main()
