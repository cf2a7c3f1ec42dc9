"""Many runs compared, and the one way to run many; the folders of results that runs leave."""
