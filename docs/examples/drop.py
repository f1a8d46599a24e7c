"""Simulate a drop, tune another simulation to it, and print what came out."""

import tunenet_logs as tn


def main() -> None:
    """Without files: the episode is in memory, as your own arrays would be."""
    order = tn.DropOrder(restitution=0.75, height_m=1.2, noise_m=0.001, seed=1)
    tuning = tn.tune(tn.simulate(order))
    print(tuning.verdict, tuning.reason or "")
    print(tuning.to_frame().to_string())
    for bounce in tuning.record.rebounds[:3]:
        print(f"{bounce.impact_speed_m_s:.2f} m/s: {bounce.restitution:.4f}")
    for check in tuning.checks:
        print("passed" if check.passed else "failed", check.name, check.detail, sep="  ")


if __name__ == "__main__":
    main()
