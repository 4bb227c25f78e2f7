"""The service's typed HTTP client. Nothing that serves imports it: a server that fetches nothing cannot be made to.

::

    from service.client.client import Client

    with Client("https://avatars.example.org", api_key=key) as client:
        job = client.submit(Path("me.jpg"), {"seed": 1})
        job = client.wait(job.id)
        client.download(job.id, Path("me.zip"))
"""
