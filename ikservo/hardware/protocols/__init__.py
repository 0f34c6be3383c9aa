"""Drivers for Dynamixel and Feetech servos, on the SDKs of their vendors."""
