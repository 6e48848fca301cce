"""Runs llama.cpp's server with a model of random weights, and prints its URL. Usage: serve.py FOLDER PORT"""
import os
import sys

import xllamacpp

import model

folder, port = sys.argv[1], int(sys.argv[2])
file = os.path.join(folder, "random.gguf")
model.write(file)
parameters = xllamacpp.CommonParams()
parameters.model.path = file
parameters.n_ctx = model.CONTEXT
parameters.n_parallel = 1
parameters.warmup = False
parameters.port = port
server = xllamacpp.Server(parameters)
print("serving", server.listening_address, flush=True)
# The check closes the standard input at its end.
sys.stdin.read()
