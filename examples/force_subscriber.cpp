// Reads the estimator's force as a ros2_control sensor component would, and prints it.
//
//     ros2 run force_subscriber force_subscriber
//
// The read() of a hardware_interface::SensorInterface returns these six numbers. CMake needs rclcpp and
// cablesense_msgs (docs/controller.md).

#include <array>
#include <chrono>
#include <limits>

#include "cablesense_msgs/msg/force_estimate.hpp"
#include "rclcpp/rclcpp.hpp"

using cablesense_msgs::msg::ForceEstimate;

class ForceSubscriber : public rclcpp::Node
{
public:
  ForceSubscriber()
  : Node("force_subscriber"),
    stale_after_(rclcpp::Duration::from_seconds(declare_parameter("stale_after_s", 0.2)))
  {
    subscription_ = create_subscription<ForceEstimate>(
      "estimator/estimate", rclcpp::SensorDataQoS(),
      [this](ForceEstimate::ConstSharedPtr message) { latest_ = message; });
    timer_ = create_wall_timer(std::chrono::milliseconds(500), [this]() {
      const auto wrench = read();
      RCLCPP_INFO(get_logger(), "force (%.2f, %.2f, %.2f) N", wrench[0], wrench[1], wrench[2]);
    });
  }

  /// Force, N, and torque, N m, in base_link; NaN while they are not known or have not come.
  std::array<double, 6> read() const
  {
    std::array<double, 6> wrench;
    wrench.fill(std::numeric_limits<double>::quiet_NaN());
    if (!latest_ || now() - rclcpp::Time(latest_->header.stamp) > stale_after_) {
      return wrench;
    }
    if (latest_->state == ForceEstimate::FREE || latest_->state == ForceEstimate::CONTACT) {
      const auto & force = latest_->wrench_base.force;
      const auto & torque = latest_->wrench_base.torque;
      wrench = {force.x, force.y, force.z, torque.x, torque.y, torque.z};
    }
    return wrench;
  }

private:
  const rclcpp::Duration stale_after_;
  ForceEstimate::ConstSharedPtr latest_;
  rclcpp::Subscription<ForceEstimate>::SharedPtr subscription_;
  rclcpp::TimerBase::SharedPtr timer_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<ForceSubscriber>());
  rclcpp::shutdown();
  return 0;
}
