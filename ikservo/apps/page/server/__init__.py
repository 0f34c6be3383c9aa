"""The web server of the page: keys, certificate, sockets."""
