"""Random and mutated frames: no exception, no hang, and the next ping is always answered."""

from __future__ import annotations

import random

import pytest

from servosim.frames import encode1, encode2
from servosim.servo import BusProtocol

MODELS = ["XL330-M288", "XL430-W250", "XM540-W270", "AX-12A", "MX-28", "STS3215", "SCS0009"]
INSTRUCTIONS = (1, 2, 3, 4, 5, 6, 8, 0x0A, 0x0B, 0x10, 0x20, 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A)


class Client:
    """Sends frames to one servo and checks now and then whether it still answers."""

    def __init__(self, port, seed):
        self.port, self.chance = port, random.Random(seed)
        self.servo = port.line.world.servos[0]
        port.timeout = 0.5

    def throw(self):
        kind = self.chance.random()
        frame = self.well_formed()
        if kind < 0.25:
            frame = self.chance.randbytes(self.chance.randrange(40))
        elif kind < 0.5:
            frame = self.mutated(frame)
        self.port.write(frame)

    def well_formed(self):
        instruction = self.chance.choice((*INSTRUCTIONS, self.chance.randrange(256)))
        id_ = self.chance.choice((self.servo.id, 254, self.chance.randrange(254)))
        params = self.chance.randbytes(self.chance.choice((0, 1, 2, 3, 4, 5, 6, 7, 9, 14, 30)))
        if params and self.chance.random() < 0.7:  # an address that exists
            table = self.servo.table
            address = self.chance.choice(table.registers).address
            size = 2 if self.new else 1
            params = address.to_bytes(2, "little")[:size] + params[size:]
        return encode2(id_, instruction, params) if self.new else encode1(id_, instruction, params)

    def mutated(self, frame):
        data = bytearray(frame)
        for _ in range(self.chance.randrange(1, 4)):
            at = self.chance.randrange(len(data))
            match self.chance.randrange(4):
                case 0:
                    data[at] ^= 1 << self.chance.randrange(8)
                case 1 if len(data) > 1:
                    del data[at]
                case 2:
                    data.insert(at, self.chance.randrange(256))
                case _:
                    data = data[: at + 1]
        return bytes(data)

    @property
    def new(self):
        return self.servo.protocol is BusProtocol.DYNAMIXEL_2

    def is_answered(self):
        """Ping the servo after half a frame has timed out and a boot has ended."""
        self.port.flush()
        self.port.baudrate = self.servo.baud
        self.port.clock.sleep_until(self.port.clock.now_s() + 1.0)
        self.port.reset_input_buffer()
        ping = encode2(self.servo.id, 1) if self.new else encode1(self.servo.id, 1)
        self.port.write(ping)
        return len(self.port.read(14 if self.new else 6)) >= 6


def throw_many(port, frames, seed, every):
    client = Client(port, seed)
    for count in range(1, frames + 1):
        client.throw()
        if count % every == 0:
            assert client.is_answered(), f"{client.servo.table.model}: frame {count}, seed {seed}"


@pytest.mark.parametrize("model", MODELS)
def test_simulated_servo_survives_2000_random_frames(make_port, model):
    throw_many(make_port(model), frames=2_000, seed=1, every=10)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("model", MODELS)
def test_simulated_servo_survives_150000_random_frames(make_port, model):
    for seed in range(10):
        throw_many(make_port(model), frames=15_000, seed=seed, every=25)
