#include "machine/simulated_machine.h"

#include <algorithm>
#include <array>

#include "design/core/errors.h"
#include "machine/detail/controller.h"
#include "machine/detail/mill.h"
#include "machine/pseudo_terminal.h"

namespace lightmill {

Personality personality(std::string_view name) {
  if (name == "grbl") return Personality::kGrbl;
  if (name == "grblhal") return Personality::kGrblHal;
  if (name == "fe") return Personality::kBlockwise;
  if (name == "drip") return Personality::kDripFeed;
  throw InputError("protocol '" + std::string(name) + "' is none of grbl, grblhal, fe, drip");
}

void plant_fault(std::string_view text, unsigned seed, LineOptions& line, PlantedFaults& control) {
  struct Named {
    std::string_view name;
    long PlantedFaults::*line;
  };
  constexpr Named kNamed[] = {
      {"error", &PlantedFaults::error_at_line}, {"alarm", &PlantedFaults::alarm_at_line},
      {"door", &PlantedFaults::door_at_line},   {"reset", &PlantedFaults::reset_at_line},
      {"power-loss", &PlantedFaults::power_loss_at_line}, {"lose-line", &PlantedFaults::drop_line_at}};
  const auto place = fault_place(text, seed);
  std::string known;
  for (const Named& named : kNamed) {
    known += (known.empty() ? "" : ", ") + std::string(named.name);
    if (!place || text.substr(0, text.find('@')) != named.name) continue;
    control.*named.line = *place;
    return;
  }
  try {
    line.faults.push_back(line_fault(text, seed));
  } catch (const InputError& error) {
    throw InputError(std::string(error.what()) + "; nor of the control's, by a program line: " + known);
  }
}

namespace {

std::unique_ptr<detail::Controller> make_controller(detail::Mill& mill, Personality personality) {
  const bool takes_text = personality == Personality::kBlockwise || personality == Personality::kDripFeed;
  if (takes_text && mill.options().planted != PlantedFaults{}) {
    throw InputError("faults of the control can be planted in grbl and grblhal only; those of the line in all protocols");
  }
  switch (personality) {
    case Personality::kBlockwise:
      return detail::make_blockwise_controller(mill);
    case Personality::kDripFeed:
      return detail::make_drip_controller(mill);
    case Personality::kGrbl:
    case Personality::kGrblHal:
      break;
  }
  return detail::make_grbl_controller(mill, personality);
}

}  // namespace

struct SimulatedMachine::Impl {
  detail::Mill mill;
  std::unique_ptr<detail::Controller> controller;
  std::string program;

  Impl(const MachineModel& machine, const OperatorSetup& setup, const SimulationOptions& options)
      : mill(machine, setup, options), controller(make_controller(mill, options.personality)) {}
};

SimulatedMachine::SimulatedMachine(const MachineModel& machine, const OperatorSetup& setup,
                                   const SimulationOptions& options)
    : impl_(std::make_unique<Impl>(machine, setup, options)) {
  impl_->mill.on_motion = [this](const Motion& motion, const std::vector<SweptMove>& pieces) {
    if (on_motion) on_motion(motion, pieces);
  };
}

SimulatedMachine::~SimulatedMachine() = default;

void SimulatedMachine::start() {
  impl_->controller->power_on();
}

void SimulatedMachine::receive(std::string_view bytes) {
  impl_->mill.advance();
  impl_->controller->receive(bytes);
}

int SimulatedMachine::work(int lines) {
  impl_->mill.advance();
  int done = 0;
  while (done < lines && impl_->controller->work()) ++done;
  return done;
}

std::string SimulatedMachine::take_replies() {
  return impl_->controller->take_replies();
}

void SimulatedMachine::begin_program(const std::string& name) {
  impl_->program = name;
  impl_->mill.begin_program(name);
  impl_->controller->begin_program();
}

bool SimulatedMachine::busy() const {
  return impl_->mill.moving();
}

ClockTime SimulatedMachine::next_event() const {
  return std::min(impl_->mill.next_event(), impl_->controller->next_event());
}

bool SimulatedMachine::behind() const {
  return impl_->mill.stock() != nullptr && impl_->mill.stock()->behind();
}

bool SimulatedMachine::dead() const {
  return impl_->controller->dead();
}

SimulationResult SimulatedMachine::result() const {
  SimulationResult result;
  impl_->mill.add_to(result);
  impl_->controller->add_to(result);
  if (result.overflowed_bytes > 0) {
    Fault fault;
    fault.kind = "overflow";
    fault.program = impl_->program;
    fault.message = std::to_string(result.overflowed_bytes) + " bytes lost because the receive buffer was full";
    result.faults.push_back(std::move(fault));
  }
  if (detail::StockWorker* stock = impl_->mill.stock()) {
    stock->finish();
    result.faults.insert(result.faults.end(), stock->faults().begin(), stock->faults().end());
  }
  return result;
}

MachinedSurface SimulatedMachine::machined() {
  detail::StockWorker* stock = impl_->mill.stock();
  if (stock == nullptr) return {};
  stock->finish();
  return stock->stock().surface();
}

std::shared_ptr<const SolidStock> SimulatedMachine::solid() {
  detail::StockWorker* stock = impl_->mill.stock();
  if (stock == nullptr) return nullptr;
  stock->finish();
  return stock->stock().solid();
}

void serve(SimulatedMachine& machine, PseudoTerminal& terminal, const LineOptions& line,
           const std::function<bool()>& should_end) {
  using std::chrono::milliseconds;
  // A few lines at a time, then their acknowledgements: the sender writes the next ones while we work.
  constexpr int kLinesAtOnce = 16;
  const Clock& clock = wall_clock();
  Cable to_machine(line, true), to_sender(line, false);
  std::array<char, 65536> bytes;
  std::string unsent;
  bool progress = true;
  while (!should_end()) {
    // Real-time bytes must not wait for lines, so the terminal is looked at between batches.
    const bool behind = machine.behind();
    const bool waits = behind || machine.busy() || !unsent.empty() || to_machine.waiting() + to_sender.waiting() > 0;
    const std::size_t count = terminal.read_some(bytes, milliseconds(progress ? 0 : waits ? 1 : 20));
    to_machine.put({bytes.data(), count}, clock.now());
    const std::string arrived = to_machine.take(clock.now());
    machine.receive(arrived);
    const int lines = behind ? 0 : machine.work(kLinesAtOnce);
    to_sender.put(machine.take_replies(), clock.now());
    unsent += to_sender.take(clock.now());
    if (!unsent.empty()) unsent.erase(0, terminal.write_some(unsent, milliseconds(0)));
    if (machine.dead() || to_machine.hung_up() || to_sender.hung_up()) {
      terminal.hang_up();
      return;
    }
    progress = count > 0 || lines > 0;
  }
}

}  // namespace lightmill
