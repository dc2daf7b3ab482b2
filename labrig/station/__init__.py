"""What stands behind the operator's window: the devices' thread, jobs, results as shown."""
