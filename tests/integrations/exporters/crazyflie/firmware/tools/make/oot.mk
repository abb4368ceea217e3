# Stand-in for the firmware's build: compiles what the app's Kbuild files name, as the firmware does from the app's folder, and asks for
# what the app's configuration must hold.
include $(PWD)/Kbuild
folder := $(obj-y)
obj-y :=
include $(PWD)/$(folder)Kbuild
built := $(addprefix $(PWD)/build/,$(obj-y))

all: $(PWD)/build/app

$(PWD)/build/app: $(built)
	grep -q '^CONFIG_APP_ENABLE=y$$' $(OOT_CONFIG)
	grep -q '^CONFIG_CONTROLLER_OOT=y$$' $(OOT_CONFIG)
	$(CC) -shared $(built) -o $@ -lm

$(PWD)/build/%.o: $(PWD)/$(folder)%.c
	mkdir -p $(PWD)/build
	$(CC) $(CFLAGS) -I$(CRAZYFLIE_BASE) -c $< -o $@
