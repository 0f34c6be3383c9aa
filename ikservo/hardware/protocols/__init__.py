"""Packets of Dynamixel and Feetech servos on the SDKs of their vendors."""
