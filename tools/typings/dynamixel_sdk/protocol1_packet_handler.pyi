from dynamixel_sdk.protocol2_packet_handler import _Port

class Protocol1PacketHandler:
    def txPacket(self, port: _Port, txpacket: list[int]) -> int: ...
