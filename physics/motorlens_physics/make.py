"""What is known of a make, put into the motor file of one of its motors."""

from dataclasses import replace

from motorlens_physics.motor_file import Knowledge, MotorFile


def of_make(file: MotorFile, make: MotorFile) -> MotorFile:
    """A motor's file with what its make's says better: values and deviations, and effects that the motor's lacks.

    A parameter is the motor's own where its file states a smaller deviation than the make's, 0 included.

    Args:
        file: of the motor.
        make: of the make, as `motorlens fleet` writes it: values and deviations of a motor that was not recorded yet.
    """
    motor = file.motor
    for effect in make.motor.effects:
        if motor.effect(effect.name()) is None:
            motor = motor.with_effect(effect)
    names = {sensor.name() for sensor in file.sensors}
    sensors = (*file.sensors, *(sensor for sensor in make.sensors if sensor.name() not in names))
    wider = replace(file, motor=motor, sensors=sensors)
    values, known = make.values(), {}
    for key, of_the_make in make.knowledge.items():
        own = file.knowledge.get(key, Knowledge()).sd
        if of_the_make.sd is not None and (own is None or own > of_the_make.sd):
            known[key] = of_the_make
    return wider.with_values({key: values[key] for key in known}, known)
