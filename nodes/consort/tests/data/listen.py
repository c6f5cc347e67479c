"""Listens on a Unix socket and runs a driver for each connection: listen.py SOCKET PROGRAM [ARGUMENTS...]"""
import os, signal, socket, sys

signal.signal(signal.SIGCHLD, signal.SIG_IGN)
server = socket.socket(socket.AF_UNIX)
server.bind(sys.argv[1])
server.listen()
print("listening", flush=True)
while True:
    connection, _ = server.accept()
    if os.fork() == 0:
        os.dup2(connection.fileno(), 0), os.dup2(connection.fileno(), 1)
        connection.close(), server.close()
        os.execvp(sys.argv[2], sys.argv[2:])
    connection.close()
