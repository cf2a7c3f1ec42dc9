"""Fly the paper's second experiment and see whether every carrier kept its speed."""

from drake_nonstop import compute_metrics, load_scenario, simulate


def main(duration: float = 15.0) -> None:
    """Simulates the quintic task for `duration` seconds and prints what matters."""
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    metrics = compute_metrics(simulate(scenario))
    carriers, load = metrics["carriers"], metrics["load"]
    print(f"slowest carrier   {carriers['speed_min_m_s']:.3f} m/s")
    print(f"bound             {carriers['speed_bound_m_s']:.3f} m/s")
    print(f"time below it     {carriers['time_below_bound_s']:.3f} s")
    print(f"mean load error   {1e3 * load['position_error_mean_m']:.2f} mm")
    print(f"real-time factor  {metrics['real_time_factor']:.1f}")


if __name__ == "__main__":
    main()
