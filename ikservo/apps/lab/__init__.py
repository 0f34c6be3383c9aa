"""What measures an arm: accuracy after ISO 9283, excitation, identification, benchmarks."""
